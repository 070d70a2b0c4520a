/* Cost against discomfort: a panel per window and tariff, their legend, and the buttons for all of them. */
"use strict";

const Pareto = (() => {
  const { data, element, drawn } = Page;
  const view = { hidden: new Set(), logarithmic: true };

  function draw(host, legendHost, toolsHost) {
    const panels = data.groups.filter((group) => group.points.length).map((group) => new ParetoPanel(host, group, view));
    for (const controller of data.controllers.filter((controller) => !controller.swept)) {
      const icon = drawn("svg", { viewBox: "-9 -9 18 18", class: "icon", width: 16, height: 16 }, Marks.mark(controller.name));
      const button = element("button", { type: "button", class: "key", "data-key": controller.name, "aria-pressed": "true" }, icon, controller.name);
      button.addEventListener("click", () => {
        const shown = view.hidden.has(controller.name);
        if (shown) view.hidden.delete(controller.name); else view.hidden.add(controller.name);
        button.setAttribute("aria-pressed", String(shown));
        panels.forEach((panel) => panel.draw());
      });
      legendHost.append(button);
    }
    const scale = element("button", { type: "button", "aria-pressed": "true" }, "logarithmic discomfort");
    scale.addEventListener("click", () => {
      view.logarithmic = !view.logarithmic;
      scale.setAttribute("aria-pressed", String(view.logarithmic));
      panels.forEach((panel) => { panel.zoomed = null; panel.draw(); });
    });
    const all = element("button", { type: "button" }, "all");
    all.addEventListener("click", () => panels.forEach((panel) => { panel.zoomed = null; panel.draw(); }));
    toolsHost.append(scale, all);
    panels.forEach((panel) => panel.draw());
    return panels;
  }

  return { draw };
})();
