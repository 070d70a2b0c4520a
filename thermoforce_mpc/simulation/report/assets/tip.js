/* The box beside the pointer, one for all of the page, and what lines look like in it and in legends. */
"use strict";

const Tip = (() => {
  const { element } = Page;

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
    const mark = element("i", { class: band ? "swatch area" : "swatch" });
    mark.style.setProperty("--c", `var(${colour})`);
    if (dash) mark.classList.add("dashed");
    return mark;
  }

  return { tell, hush, entry, swatch };
})();
