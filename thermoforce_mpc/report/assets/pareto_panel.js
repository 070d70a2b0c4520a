/* A panel of cost against discomfort: a mark per controller, the front as a line of steps, a sweep as a line. */
"use strict";

const ParetoPanel = (() => {
  const { data, element, drawn, ticks, digitsOf, formatted } = Page;
  const HEIGHT = 330, LEFT = 58, BOTTOM = 44, TOP = 14, RIGHT = 18;
  // Discomfort spans orders of magnitude and may be zero: straight below this, K·h, logarithmic above.
  const STRAIGHT = 0.5, ROUND = [0, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];
  // Up to this many points all have their names beside them; of more only those of the front.
  const MOST_LABELS = 6;

  /* `view`: {hidden, logarithmic}, what all panels share. */
  class Panel {
    constructor(host, group, view) {
      Object.assign(this, { group, view, zoomed: null });
      this.place = element("div", { class: "plot" });
      const save = element("button", { type: "button", class: "no-print", onclick: () => this.save() }, "save as SVG");
      const figure = element("figure", { class: "chart panel" }, element("figcaption", {}, group.title), this.place, save);
      host.append(figure);
      new ResizeObserver(() => this.draw()).observe(this.place);
      this.place.addEventListener("dblclick", () => { this.zoomed = null; this.draw(); });
    }

    /* Discomfort as it is drawn. */
    warped(discomfort) {
      return this.view.logarithmic ? Math.asinh(discomfort / STRAIGHT) : discomfort;
    }

    get shown() {
      return this.group.points.filter((point) => !this.view.hidden.has(point.name));
    }

    /* Limits of both axes: [discomfort, cost], as they are drawn. */
    limits() {
      if (this.zoomed) return this.zoomed;
      const range = (values, room) => {
        const least = Math.min(...values), most = Math.max(...values);
        const width = Math.max(most - least, 0.02 * Math.abs(most), 1e-4);
        return [least - room * width, most + room * width];
      };
      const points = this.shown.length ? this.shown : this.group.points;
      const x = range(points.map((point) => this.warped(point.discomfort)), 0.14);
      return { x: [Math.max(x[0], -0.12), x[1]], y: range(points.map((point) => point.cost), 0.12) };
    }

    draw() {
      const width = Math.max(260, this.place.clientWidth), { x: xs, y: ys } = this.limits();
      const x = (discomfort) => LEFT + ((width - LEFT - RIGHT) * (this.warped(discomfort) - xs[0])) / (xs[1] - xs[0]);
      const y = (cost) => TOP + ((HEIGHT - TOP - BOTTOM) * (ys[1] - cost)) / (ys[1] - ys[0]);
      const svg = drawn("svg", {
        viewBox: `0 0 ${width} ${HEIGHT}`, width, height: HEIGHT, role: "img", class: "pareto",
        "aria-label": `cost against discomfort, ${this.group.title}`,
      });
      const inside = drawn("svg", { x: LEFT, y: TOP, width: width - LEFT - RIGHT, height: HEIGHT - TOP - BOTTOM,
        viewBox: `${LEFT} ${TOP} ${width - LEFT - RIGHT} ${HEIGHT - TOP - BOTTOM}` });
      this.axes(svg, width, xs, ys, x, y);
      const front = this.shown.filter((point) => point.pareto).sort((a, b) => a.discomfort - b.discomfort);
      const corner = front.map((p, i) => (i ? `H${x(p.discomfort)}V${y(p.cost)}` : `M${x(p.discomfort)},${y(p.cost)}`));
      if (front.length) inside.append(drawn("path", { class: "front", d: corner.join("") }));
      const line = data.controllers.filter((controller) => controller.swept).map((controller) => this.shown.find((p) => p.name === controller.name))
        .filter(Boolean);
      if (line.length) {
        inside.append(drawn("path", { class: "sweep", d: line.map((p, i) => `${i ? "L" : "M"}${x(p.discomfort)},${y(p.cost)}`).join("") }));
      }
      svg.append(inside);
      this.points(svg, width, x, y);
      this.place.replaceChildren(svg);
      this.listen(svg, width, xs, ys);
    }

    axes(svg, width, xs, ys, x, y) {
      const seen = (value) => this.warped(value) >= xs[0] && this.warped(value) <= xs[1];
      const [least, most] = this.view.logarithmic ? xs.map((at) => STRAIGHT * Math.sinh(at)) : xs, round = ROUND.filter(seen);
      const marks = this.view.logarithmic && round.length > 2 ? round : ticks(Math.max(0, least), most).filter(seen);
      let before = -Infinity;
      for (const at of marks) {
        if (x(at) - before < 34) continue;
        before = x(at);
        svg.append(drawn("line", { class: "grid", x1: before, x2: before, y1: TOP, y2: HEIGHT - BOTTOM }));
        svg.append(drawn("text", { x: before, y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, String(Number(at.toFixed(4)))));
      }
      const costs = ticks(...ys), digits = digitsOf(costs);
      for (const at of costs) {
        svg.append(drawn("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(at), y2: y(at) }));
        svg.append(drawn("text", { x: LEFT - 6, y: y(at) + 4, "text-anchor": "end" }, formatted(at, digits)));
      }
      svg.append(drawn("text", { x: (LEFT + width - RIGHT) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, "discomfort, K·h"));
      const middle = (TOP + HEIGHT - BOTTOM) / 2;
      svg.append(drawn("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` },
        `cost, ${data.currency}/m²`));
    }

    points(svg, width, x, y) {
      const visible = this.shown.filter((p) => x(p.discomfort) >= LEFT - 1 && x(p.discomfort) <= width - RIGHT + 1
        && y(p.cost) >= TOP - 1 && y(p.cost) <= HEIGHT - BOTTOM + 1);
      const named = visible.length <= MOST_LABELS || data.controllers.some((controller) => controller.swept);
      // Places of marks and names, [left, right, height]: a name stands where there is none.
      const taken = visible.map((point) => [x(point.discomfort) - 8, x(point.discomfort) + 8, y(point.cost) + 4]);
      for (const point of visible) {
        const at = [x(point.discomfort), y(point.cost)], made = Marks.mark(point.name);
        made.setAttribute("transform", `translate(${at[0]},${at[1]})`);
        made.setAttribute("tabindex", "0");
        made.setAttribute("data-name", point.name);
        made.append(drawn("title", {}, words(point).join("; ")));
        const say = (event) => Tip.tell(event, [element("div", { class: "tip-time" }, point.name),
          ...words(point).slice(1).map((text) => element("div", {}, text))]);
        made.addEventListener("mousemove", say);
        made.addEventListener("mouseleave", Tip.hush);
        made.addEventListener("focus", () => {
          const box = made.getBoundingClientRect();
          say({ clientX: box.right, clientY: box.bottom });
        });
        made.addEventListener("blur", Tip.hush);
        svg.append(made);
        if (named || point.pareto) svg.append(nameBeside(point, at, width, taken));
      }
    }

    /* Drag to zoom; a double click, which the place hears, shows all of it. */
    listen(svg, width, xs, ys) {
      const place = (event) => {
        const box = svg.getBoundingClientRect();
        return [Math.max(LEFT, Math.min(width - RIGHT, event.clientX - box.left)),
          Math.max(TOP, Math.min(HEIGHT - BOTTOM, event.clientY - box.top))];
      };
      const value = ([px, py]) => [xs[0] + ((px - LEFT) / (width - LEFT - RIGHT)) * (xs[1] - xs[0]),
        ys[1] - ((py - TOP) / (HEIGHT - TOP - BOTTOM)) * (ys[1] - ys[0])];
      let from = null;
      const frame = drawn("rect", { class: "zoom", width: 0, height: 0 });
      svg.append(frame);
      svg.addEventListener("pointerdown", (event) => {
        if (event.pointerType === "mouse" && event.button === 0) {
          from = place(event);
          svg.setPointerCapture(event.pointerId);
          event.preventDefault();
        }
      });
      svg.addEventListener("pointermove", (event) => {
        if (!from) return;
        const to = place(event);
        for (const [name, at] of [["x", 0], ["y", 1]]) frame.setAttribute(name, Math.min(from[at], to[at]));
        frame.setAttribute("width", Math.abs(from[0] - to[0]));
        frame.setAttribute("height", Math.abs(from[1] - to[1]));
      });
      svg.addEventListener("pointerup", (event) => {
        if (!from) return;
        const to = place(event), [a, b] = [value(from), value(to)];
        const wide = Math.abs(from[0] - to[0]) > 8 && Math.abs(from[1] - to[1]) > 8;
        from = null;
        if (wide) {
          const sorted = (k) => [Math.min(a[k], b[k]), Math.max(a[k], b[k])];
          this.zoomed = { x: sorted(0), y: sorted(1) };
          this.draw();
        } else {
          for (const name of ["width", "height"]) frame.setAttribute(name, 0);
        }
      });
    }

    /* The drawing as a file, with its colours written out. */
    save() {
      const svg = this.place.querySelector("svg"), copy = svg.cloneNode(true);
      const originals = svg.querySelectorAll("*"), copies = copy.querySelectorAll("*");
      originals.forEach((original, i) => {
        const style = getComputedStyle(original);
        for (const name of ["fill", "stroke", "stroke-width", "font", "stroke-dasharray", "paint-order"]) {
          copies[i].style.setProperty(name, style.getPropertyValue(name));
        }
      });
      copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
      const address = URL.createObjectURL(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
      const link = element("a", { href: address, download: `${this.group.title.replace(/[^\w.-]+/g, "_")}.svg` });
      link.click();
      URL.revokeObjectURL(address);
    }
  }

  /* A point in words. */
  function words(point) {
    const lines = [point.name, `cost ${formatted(point.cost, 4)} ${data.currency}/m²`, `discomfort ${formatted(point.discomfort)} K·h`,
      `energy ${formatted(point.energy, 3)} kWh/m²`];
    if (point.fallbacks) lines.push(`${point.fallbacks} steps fell back`);
    if (point.pareto) lines.push("on the front: no other is better in both");
    return lines;
  }

  /* The name beside a point, right or left of it, above or below, where no mark and no other name is. */
  function nameBeside(point, [px, py], width, taken) {
    const text = Marks.label(point.name), long = 7 * text.length;
    const sides = [[px + 9, px + 9 + long, "start"], [px - 9 - long, px - 9, "end"]].filter(([from, to]) => from > LEFT && to < width);
    const places = [4, -12, 20, -28, 36, -44, 52].flatMap((off) => sides.map((side) => [...side, py + off]))
      .filter(([, , , height]) => height > TOP + 8 && height < HEIGHT - BOTTOM);
    const free = ([from, to, , height]) => taken.every(([x1, x2, y2]) => Math.abs(y2 - height) > 15 || x2 < from || x1 > to);
    const [from, to, anchor, height] = places.find(free) || [px + 9, px + 9 + long, "start", py + 4];
    taken.push([from, to, height]);
    return drawn("text", { class: "name", x: anchor === "start" ? from : to, y: height, "text-anchor": anchor }, text);
  }

  return Panel;
})();
