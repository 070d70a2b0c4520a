/* The matrix of step responses: zones by actuators, the model's answer to full level with its 90 % band. */
"use strict";

const AnswerView = (() => {
  const { byId, drawn, element, ticks, digitsOf, formatted } = Page;
  const WIDTH = 300, HEIGHT = 170, LEFT = 40, BOTTOM = 30, TOP = 10, RIGHT = 8;

  function cell(answer, name, most) {
    const figure = element("figure", { class: "answer" }, element("figcaption", {}, name));
    if (!answer) {
      figure.append(element("p", { class: "what" }, "no effect"));
      return figure;
    }
    const [low, high] = [Math.min(0, ...answer.K, ...(answer.low || [])), Math.max(0.1, ...answer.K, ...(answer.high || []))];
    const room = 0.05 * (high - low);
    const x = (h) => LEFT + ((WIDTH - LEFT - RIGHT) * h) / most;
    const y = (K) => TOP + ((HEIGHT - TOP - BOTTOM) * (high + room - K)) / (high - low + 2 * room);
    const path = (hours, values) => hours.map((h, i) => `${i ? "L" : "M"}${x(h).toFixed(1)},${y(values[i]).toFixed(1)}`).join("");
    const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `step response of ${name}` });
    const marks = ticks(low, high);
    for (const K of marks) {
      svg.append(drawn("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y(K), y2: y(K) }));
      svg.append(drawn("text", { x: LEFT - 5, y: y(K) + 4, "text-anchor": "end" }, formatted(K, digitsOf(marks))));
    }
    for (const h of [0, 12, 24, 36, 48].filter((h) => h <= most)) {
      svg.append(drawn("text", { x: x(h), y: HEIGHT - 15, "text-anchor": "middle" }, String(h)));
    }
    svg.append(drawn("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 2, "text-anchor": "middle" }, "h since the step"));
    if (answer.low) {
      const back = [...answer.at].reverse(), under = [...answer.low].reverse();
      svg.append(drawn("path", { class: "band", d: `${path(answer.at, answer.high)}${path(back, under).replace("M", "L")}Z` }));
    }
    svg.append(drawn("path", { class: "answer-line", d: path(answer.hours, answer.K) }));
    (answer.at || []).forEach((h, i) => {
      const dot = drawn("circle", { class: "answer-dot", cx: x(h), cy: y(answer.mean[i]), r: 3, tabindex: 0 });
      const words = `after ${h} h: ${formatted(answer.mean[i])} K, 90 % between ${formatted(answer.low[i])} and ${formatted(answer.high[i])} K`;
      dot.append(drawn("title", {}, words));
      dot.addEventListener("mousemove", (event) => Tip.tell(event, [element("div", { class: "tip-time" }, name), words]));
      dot.addEventListener("mouseleave", Tip.hush);
      svg.append(dot);
    });
    figure.append(svg);
    return figure;
  }

  function draw() {
    const { answers, names } = Page.data, host = byId("answers");
    host.style.setProperty("--columns", names.actuators.length);
    const most = Math.max(...answers.flat().filter(Boolean).map((answer) => answer.hours[answer.hours.length - 1]));
    answers.forEach((row, z) => row.forEach((answer, a) => {
      const lone = names.zones.length === 1 && names.actuators.length === 1;
      const name = lone ? "to full level" : `${names.actuators[a]} on ${names.zones[z]}`;
      host.append(cell(answer, answer && answer.full ? `${name} (${answer.full})` : name, most));
    }));
  }

  return { draw };
})();
