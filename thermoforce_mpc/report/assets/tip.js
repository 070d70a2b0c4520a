/* The box beside the pointer, one for all of the page, and what lines look like in it and in legends. */
"use strict";

const Tip = (() => {
  const { drawn, element } = Page;

  const box = element("div", { class: "tip", role: "status", hidden: true });
  document.body.append(box);

  function tell(event, lines) {
    box.replaceChildren(...lines);
    box.hidden = false;
    const width = box.offsetWidth, height = box.offsetHeight, gap = 14;
    const x = event.clientX + gap + width > innerWidth ? event.clientX - gap - width : event.clientX + gap;
    const y = event.clientY + gap + height > innerHeight ? event.clientY - gap - height : event.clientY + gap;
    box.style.left = `${Math.max(4, x)}px`;
    box.style.top = `${Math.max(4, y)}px`;
  }

  const hush = () => { box.hidden = true; };

  /* A line of the box: what it looks like in the chart (or a colour), name, value. */
  const entry = (look, name, value) => element(
    "div", { class: "tip-row" }, swatch(typeof look === "string" ? { colour: look } : look), element("span", {}, name),
    element("b", {}, value),
  );

  /* What a line looks like, for legends. */
  function swatch({ colour, dash, band }) {
    const line = { x1: 0, x2: 26, y1: 2, y2: 2, "stroke-dasharray": (dash || []).join(" ") };
    const mark = band ? element("i", { class: "swatch area" })
      : drawn("svg", { class: "swatch", viewBox: "0 0 26 4", width: 26, height: 4 }, drawn("line", line));
    mark.style.setProperty("--c", `var(${colour})`);
    return mark;
  }

  return { tell, hush, entry, swatch };
})();
