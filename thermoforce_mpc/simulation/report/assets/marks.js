/* What controllers look like in the plots of a comparison: colour, shape and name. */
"use strict";

const Marks = (() => {
  const { data, drawn } = Page;
  const SHAPES = {
    square: (r) => `M${-r},${-r}h${2 * r}v${2 * r}h${-2 * r}Z`,
    circle: (r) => `M${-r},0a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0Z`,
    diamond: (r) => `M0,${-1.3 * r}L${1.3 * r},0L0,${1.3 * r}L${-1.3 * r},0Z`,
    up: (r) => `M0,${-1.25 * r}L${1.2 * r},${r}L${-1.2 * r},${r}Z`,
    down: (r) => `M0,${1.25 * r}L${1.2 * r},${-r}L${-1.2 * r},${-r}Z`,
  };

  /* Colour and shape of each controller: squares have no model, swept values are one colour and circles. */
  const looks = new Map();
  let plain = 0, modelled = 0;
  for (const controller of data.controllers) {
    if (controller.swept) looks.set(controller.name, { colour: "--planned", shape: "circle" });
    else if (!controller.needs_model) looks.set(controller.name, { colour: `--series-${(plain++ % 5) + 1}`, shape: "square" });
    else {
      const shape = ["circle", "diamond", "up", "down"][modelled % 4];
      looks.set(controller.name, { colour: modelled ? `--series-${(modelled % 5) + 1}` : "--planned", shape });
      modelled += 1;
    }
  }
  const look = (name) => looks.get(name);

  /* What a controller is called beside its mark: a swept one by its value. */
  const labels = new Map(data.controllers.map((controller) => [controller.name, controller.swept || controller.name]));
  const label = (name) => labels.get(name);

  /* A mark of a controller. */
  function mark(name, radius = 6) {
    const made = drawn("path", { d: SHAPES[look(name).shape](radius), class: "mark" });
    made.style.setProperty("fill", `var(${look(name).colour})`);
    return made;
  }

  return { mark, label };
})();
