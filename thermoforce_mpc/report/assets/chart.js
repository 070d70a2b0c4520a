/* Charts of courses over time, drawn by uPlot: lines, steps and bands over the time axis of their group. */
"use strict";

const Chart = (() => {
  const { element, indexAt, formatted, instant, wall, day, clock, HOUR, DAY } = Page;
  const INCREMENTS = [300, 900, 1800, HOUR, 2 * HOUR, 3 * HOUR, 6 * HOUR, 12 * HOUR]
    .concat([1, 2, 4, 7, 14, 28, 91, 182].map((days) => days * DAY));
  const all = [];

  /* Numbers as uPlot wants them: null where there is none. */
  const plain = (values) => Array.from(values, (value) => (Number.isFinite(value) ? value : null));

  /* Seconds as labels: the day at its first one, which may not be at midnight in summer time, the clock in between. */
  const timeLabels = (plot, splits, axis, space, increment) => splits.map((t) => {
    if (t === null) return "";
    return (wall(t) + 1) % DAY < increment ? day(t) : clock(t);
  });

  function axis(scale, side, label, extra = {}) {
    return {
      scale, side, label, labelSize: 18, size: 46, gap: 4, labelGap: 0, labelFont: "12px system-ui, sans-serif",
      font: "12px system-ui, sans-serif", stroke: () => Theme.colour("--quiet"),
      grid: { show: side !== 1, stroke: () => Theme.colour("--grid"), width: 1 },
      // Two labels at least, also in a low chart.
      space: (plot, axis, least, most, length) => Math.max(14, Math.min(30, length / 5)), ticks: { show: false }, ...extra,
    };
  }

  /* A chart in `host`.
   *
   * spec: title; unit of the left axis, `right` unit of the right one, `beside` room for one as in a chart above; height; `range` [least, most] of the left axis,
   * or `least`: the least height of it; lines: {key, name, x, y, colour, step, dash, width, axis, fill, digits, unit,
   * shown, rank: place in the legend, beyond: it does not set the height}; bands: {key, name, x, low, high, colour, step, shown, limit: it does not set the height}; `paint(plot)`: drawn on top.
   */
  class Course {
    constructor(host, group, spec) {
      Object.assign(this, { group, spec, parts: new Map() });
      this.figure = element("figure", { class: "chart" });
      if (spec.title) this.figure.append(element("figcaption", {}, spec.title));
      const shown = [...(spec.bands || []), ...(spec.lines || [])].map((part) => part.name).join(", ");
      this.place = element("div", { class: "plot", role: "img", "aria-label": `${spec.title || ""} ${spec.unit}: ${shown}`.trim() });
      this.figure.append(this.place);
      host.append(this.figure);
      const series = [{}], bands = [];
      for (const band of spec.bands || []) {
        const at = series.length;
        for (const end of ["high", "low"]) {
          series.push({
            label: `${band.name}, ${end}`, scale: "y", stroke: () => "transparent", width: 0, points: { show: false },
            paths: band.step ? uPlot.paths.stepped({ align: 1 }) : undefined, show: band.shown !== false,
            auto: !band.limit,
          });
        }
        bands.push({ series: [at, at + 1], fill: () => Theme.colour(band.colour) });
        this.parts.set(band.key, { ...band, at: [at, at + 1], band: true });
      }
      for (const line of spec.lines || []) {
        this.parts.set(line.key, { ...line, at: [series.length] });
        series.push({
          label: line.name, scale: line.axis === "right" ? "r" : "y", stroke: () => Theme.colour(line.colour),
          width: line.width || 1.4, dash: line.dash, points: { show: false }, show: line.shown !== false, auto: !line.beyond,
          paths: line.step ? uPlot.paths.stepped({ align: 1 }) : undefined,
          fill: line.fill ? () => Theme.colour(line.fill) : undefined, fillTo: line.fill ? 0 : undefined,
        });
      }
      const scales = {
        x: { time: false, range: (plot, least, most) => this.within(least, most) },
        y: { range: (plot, least, most) => this.height(least, most) },
        r: { range: (plot, least, most) => uPlot.rangeNum(least ?? 0, most ?? 1, 0.06, true) },
      };
      const axes = [
        axis("x", 2, null, { size: 30, gap: 8, incrs: INCREMENTS, space: 64, values: timeLabels }),
        axis("y", 3, spec.unit, spec.ticks || {}),
      ];
      if (spec.right) axes.push(axis("r", 1, spec.right));
      this.plot = new uPlot({
        width: this.width(), height: spec.height || 200, scales, axes, series, bands, legend: { show: false },
        padding: [8, spec.right ? 8 : spec.beside ? 68 : 28, 0, 0],
        cursor: {
          sync: { key: group.name, setSeries: false, scales: ["x", null] }, y: false, points: { show: false },
          drag: { x: true, y: false, setScale: true }, bind: { dblclick: () => () => { group.zoom(); } },
        },
        hooks: {
          setScale: [(plot, key) => {
            if (key === "x" && this.plot) group.zoom(plot.scales.x.min, plot.scales.x.max);
          }],
          draw: [(plot) => this.paint(plot)],
        },
      }, this.joined(), this.place);
      const over = this.plot.over;
      over.addEventListener("mousemove", (event) => this.hover(event));
      over.addEventListener("mouseleave", Tip.hush);
      over.addEventListener("click", (event) => {
        if (group.onPick) group.onPick(this.timeAt(event));
      });
      group.charts.push(this);
      all.push(this);
      new ResizeObserver(() => this.fit()).observe(this.place);
    }

    width() {
      return Math.max(240, Math.floor(this.place.clientWidth || 600));
    }

    fit() {
      if (this.width() !== this.plot.width) this.plot.setSize({ width: this.width(), height: this.plot.height });
    }

    within(least, most) {
      const [from, to] = this.group.span;
      if (!this.plot || least === null || most === null) return [from, to];
      return most - least < 60 ? [this.plot.scales.x.min, this.plot.scales.x.max] : [least, most];
    }

    height(least, most) {
      if (this.spec.range) return this.spec.range;
      if (least === null || most === null || least === undefined) return [0, 1];
      [least, most] = this.withLimits(least, most);
      const wanted = this.spec.least || 0, lack = Math.max(0, wanted - (most - least)) / 2;
      const shown = Math.max(most - least, wanted);
      // What does not change has its own size beside it, so that its axis has different labels.
      const room = 0.06 * (shown > 1e-6 ? shown : Math.abs(most) || 1);
      const low = least - lack - room, high = most + lack + room;
      return [this.spec.fromZero && least >= 0 ? 0 : low, high];
    }

    /* The range widened by the narrowest that a limiting band is in what is shown: at night it may be far away. */
    withLimits(least, most) {
      const [from, to] = this.plot ? this.group.shown : this.group.span;
      for (const part of this.parts.values()) {
        if (!part.limit || (this.plot && !this.isShown(part.key))) continue;
        let low = -Infinity, high = Infinity;
        for (let i = Math.max(0, indexAt(part.x, from)); i < part.x.length && part.x[i] < to; i++) {
          low = Math.max(low, part.low[i]);
          high = Math.min(high, part.high[i]);
        }
        if (Number.isFinite(low) && low > least - 6) least = Math.min(least, low);
        if (Number.isFinite(high) && high < most + 6) most = Math.max(most, high);
      }
      return [least, most];
    }

    /* All lines and bands as uPlot's table: each has instants of its own. */
    joined() {
      const tables = [];
      for (const part of this.parts.values()) {
        const rows = part.band ? [part.high, part.low] : [part.y];
        tables.push([Array.from(part.x), ...rows.map(plain)]);
      }
      return tables.length ? uPlot.join(tables, tables.map((table) => table.map(() => 2))) : [[], []];
    }

    /* Other values: {key: {x, y} or {x, low, high}}. */
    update(values) {
      for (const [key, changed] of Object.entries(values)) Object.assign(this.parts.get(key), changed);
      this.plot.setData(this.joined(), false);
      this.group.zoom();
    }

    show(key, shown) {
      const part = this.parts.get(key);
      if (part) this.plot.batch(() => part.at.forEach((index) => this.plot.setSeries(index, { show: shown })));
    }

    isShown(key) {
      return this.plot.series[this.parts.get(key).at[0]].show;
    }

    timeAt(event) {
      return this.plot.posToVal(event.clientX - this.plot.over.getBoundingClientRect().left, "x");
    }

    hover(event) {
      const t = this.timeAt(event), lines = [element("div", { class: "tip-time" }, instant(t))];
      for (const part of this.parts.values()) {
        if (!this.isShown(part.key) || part.silent) continue;
        const text = this.valueAt(part, t);
        if (text) lines.push(Tip.entry(part, part.name, text));
      }
      if (this.spec.tip) lines.push(...this.spec.tip(t));
      if (this.group.why) lines.push(...this.group.why(t));
      Tip.tell(event, lines);
    }

    /* Value of a line or band at an instant, in words; a step holds until the next one, a sample to its nearest. */
    valueAt(part, t) {
      let i = indexAt(part.x, t);
      if (!part.step && i + 1 < part.x.length && part.x[i + 1] - t < t - part.x[i]) i += 1;
      if (i < 0 || (i === part.x.length - 1 && t > part.x[i] + 2 * HOUR)) return "";
      const digits = part.digits ?? 2, unit = part.unit ? ` ${part.unit}` : "";
      if (part.band) return `${formatted(part.low[i], digits)} to ${formatted(part.high[i], digits)}${unit}`;
      return Number.isFinite(part.y[i]) ? `${formatted(part.y[i], digits)}${unit}` : "";
    }

    paint(plot) {
      const { ctx, bbox } = plot;
      ctx.save();
      if (this.spec.paint) this.spec.paint(plot);
      if (this.group.now !== null) {
        const x = Math.round(plot.valToPos(this.group.now, "x", true));
        if (x >= bbox.left && x <= bbox.left + bbox.width) {
          ctx.strokeStyle = Theme.colour("--ink");
          ctx.lineWidth = devicePixelRatio;
          ctx.setLineDash([]);
          ctx.beginPath();
          ctx.moveTo(x, bbox.top);
          ctx.lineTo(x, bbox.top + bbox.height);
          ctx.stroke();
        }
      }
      ctx.restore();
    }
  }

  /* A legend in `host` whose buttons show and hide what has their key in all of `charts`. */
  function legend(host, charts) {
    const seen = new Map();
    for (const chart of charts) for (const part of chart.parts.values()) if (!seen.has(part.key)) seen.set(part.key, part);
    const ranked = [...seen.values()].sort((part, other) => (part.rank ?? 1) - (other.rank ?? 1));
    for (const part of ranked) {
      const button = element(
        "button", { type: "button", class: "key", "data-key": part.key, "aria-pressed": String(part.shown !== false) },
        Tip.swatch(part), part.name,
      );
      button.addEventListener("click", () => {
        const shown = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(shown));
        charts.forEach((chart) => chart.show(part.key, shown));
      });
      host.append(button);
    }
  }

  Theme.onChange(() => all.forEach((chart) => chart.plot.redraw(false, true)));
  /* Paper is narrower than a desk: charts are made as wide as their place on it, and as they were afterwards. */
  matchMedia("print").addEventListener("change", () => all.forEach((chart) => chart.fit()));
  addEventListener("beforeprint", () => all.forEach((chart) => chart.fit()));
  addEventListener("afterprint", () => all.forEach((chart) => chart.fit()));

  return { Course, legend, all };
})();
