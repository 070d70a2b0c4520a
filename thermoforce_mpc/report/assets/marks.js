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
    plus: (r) => `M${-r / 3},${-r}h${r / 1.5}v${r / 1.5}h${r / 1.5}v${r / 1.5}h${-r / 1.5}v${r / 1.5}h${-r / 1.5}v${-r / 1.5}h${-r / 1.5}v${-r / 1.5}h${r / 1.5}Z`,
    cross: (r) => `M${-r},${-r / 2}L${-r / 2},${-r}L0,${-r / 2}L${r / 2},${-r}L${r},${-r / 2}L${r / 2},0L${r},${r / 2}L${r / 2},${r}L0,${r / 2}L${-r / 2},${r}L${-r},${r / 2}L${-r / 2},0Z`,
  };

  /* Swept values are one colour and circles. */
  const looks = Looks.of(data.controllers.filter((controller) => !controller.swept).map((controller) => controller.name));
  const look = (name) => looks.get(name) || { colour: "--planned", shape: "circle" };

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
