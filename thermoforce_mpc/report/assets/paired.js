/* Differences to a reference, window by window, with the interval of their mean: a row per controller. */
"use strict";

const Paired = (() => {
  const { data, byId, element, drawn, ticks, digitsOf, formatted } = Page;
  const ROW = 26, TOP = 8, BOTTOM = 36, NAME = 170, RIGHT = 14;
  const KINDS = [
    { key: "cost", unit: "%", title: "cost", digits: 1 }, { key: "discomfort", unit: "K·h", title: "discomfort", digits: 2 },
  ];

  /* The mean of differences and its interval in words. */
  function words(difference, kind) {
    const sign = (value) => (value > 0 ? "+" : "") + formatted(value, kind.digits);
    if (difference.half === null) return `${sign(difference.mean)} ${kind.unit} (one window: no interval)`;
    return `${sign(difference.mean)} ${kind.unit}, 95 % between ${sign(difference.mean - difference.half)} and ${sign(difference.mean + difference.half)}`;
  }

  function plot(place, rows, kind) {
    const width = Math.max(280, place.clientWidth), height = TOP + ROW * rows.length + BOTTOM;
    const longest = Math.max(...rows.map((row) => Marks.label(row.controller).length));
    const left = Math.min(NAME, 0.36 * width, 14 + 7.4 * longest);
    const values = rows.flatMap(({ [kind.key]: d }) => [...d.values, ...(d.half === null ? [] : [d.mean - d.half, d.mean + d.half])]);
    // An interval of two or three windows may be far wider than what was seen: it is cut at three times that.
    const seen = Math.max(...rows.flatMap((row) => row[kind.key].values.map(Math.abs)), kind.key === "cost" ? 1 : 0.1);
    const cut = (value) => Math.max(-3 * seen, Math.min(3 * seen, value));
    const low = Math.min(0, ...values.map(cut)), high = Math.max(0, ...values.map(cut)), room = 0.06 * (high - low || seen);
    const x = (value) => left + ((width - left - RIGHT) * (cut(value) - low + room)) / (high - low + 2 * room);
    const svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", class: "paired",
      "aria-label": `difference of ${kind.title}` });
    const marks = ticks(low - room, high + room);
    for (const at of marks) {
      svg.append(drawn("line", { class: at === 0 ? "zero" : "grid", x1: x(at), x2: x(at), y1: TOP, y2: height - BOTTOM }));
      svg.append(drawn("text", { x: x(at), y: height - BOTTOM + 15, "text-anchor": "middle" }, formatted(at, digitsOf(marks))));
    }
    svg.append(drawn("line", { class: "zero", x1: x(0), x2: x(0), y1: TOP, y2: height - BOTTOM }));
    svg.append(drawn("text", { x: (left + width) / 2, y: height - 4, "text-anchor": "middle" }, `difference of ${kind.title}, ${kind.unit}`));
    rows.forEach((row, i) => {
      const difference = row[kind.key], y = TOP + ROW * (i + 0.5), name = drawn("text", { x: left - 8, y: y + 4, "text-anchor": "end", class: "name" });
      const text = Marks.label(row.controller), most = Math.floor((left - 8) / 7.4);
      name.append(text.length > most ? `${text.slice(0, most - 1)}…` : text, drawn("title", {}, row.controller));
      const line = drawn("g", { class: "difference", tabindex: 0, "data-name": row.controller });
      line.append(drawn("rect", { x: left, y: y - ROW / 2, width: width - left - RIGHT, height: ROW, class: "hit" }));
      for (const value of difference.values) line.append(drawn("circle", { cx: x(value), cy: y, r: 3, class: "window" }));
      if (difference.half !== null) {
        line.append(drawn("line", { class: "interval", x1: x(difference.mean - difference.half), x2: x(difference.mean + difference.half), y1: y, y2: y }));
      }
      const middle = Marks.mark(row.controller, 5);
      middle.setAttribute("transform", `translate(${x(difference.mean)},${y})`);
      line.append(middle);
      line.addEventListener("mousemove", (event) => Tip.tell(event, [
        element("div", { class: "tip-time" }, row.controller), element("div", {}, words(difference, kind)),
        ...difference.values.map((value, k) => element("div", {}, `${row.windows[k]}: ${value > 0 ? "+" : ""}${formatted(value, kind.digits)} ${kind.unit}`)),
      ]));
      line.addEventListener("mouseleave", Tip.hush);
      svg.append(name, line);
    });
    place.replaceChildren(svg);
  }

  function draw() {
    const host = byId("paired"), select = byId("reference");
    const places = [];
    for (const set of data.paired) {
      host.append(element("h3", {}, `${set.title}: ${set.windows.length} ${set.windows.length === 1 ? "window" : "windows"}`));
      const pair = element("div", { class: "pair" });
      for (const kind of KINDS) {
        const place = element("div", { class: "plot" });
        pair.append(place);
        places.push({ place, set, kind });
      }
      host.append(pair);
    }
    const table = byId("paired-table");
    const show = () => {
      for (const { place, set, kind } of places) {
        const rows = set.differences.filter((difference) => difference.reference === select.value);
        if (rows.length) plot(place, rows, kind); else place.replaceChildren("nothing to compare with here");
      }
      table.replaceChildren(element("tr", {}, ...["", "tariff", "cost", "discomfort", "windows"].map((text) => element("th", {}, text))));
      for (const set of data.paired) {
        for (const row of set.differences.filter((difference) => difference.reference === select.value)) {
          table.append(element("tr", {}, ...[row.controller, set.title, words(row.cost, KINDS[0]), words(row.discomfort, KINDS[1]), String(row.windows.length)]
            .map((text) => element("td", {}, text))));
        }
      }
    };
    for (const reference of data.references) select.append(element("option", { value: reference, selected: reference === data.reference }, reference));
    select.addEventListener("change", show);
    new ResizeObserver(show).observe(host);
    show();
    return { show };
  }

  return { draw };
})();
