/* Charts that belong together: one time axis, zoom and cursor, and the buttons for them. */
"use strict";

const Group = (() => {
  const { element, DAY } = Page;

  /* `span`: [first, last] instant, s; `why(t)`: what to say of an instant beside the values of a chart. */
  return class {
    constructor(name, span, why = null) {
      Object.assign(this, { name, span: [...span], why, charts: [], now: null, onPick: null, busy: false });
    }

    /* Show [from, to], or all of it. */
    zoom(from = this.span[0], to = this.span[1]) {
      if (this.busy) return;
      this.busy = true;
      for (const chart of this.charts) chart.plot.setScale("x", { min: from, max: to });
      this.busy = false;
    }

    get shown() {
      const scale = this.charts[0].plot.scales.x;
      return [scale.min, scale.max];
    }

    /* Another span, all of which is shown. */
    move(span) {
      this.span = [...span];
      this.zoom();
    }

    /* Mark an instant in all charts. */
    mark(t) {
      this.now = t;
      for (const chart of this.charts) chart.plot.redraw(false, false);
    }

    /* Buttons for what a mouse does by dragging: whole, a day, on and back. */
    toolbar(host) {
      const step = (share) => {
        const [from, to] = this.shown, width = to - from;
        const start = Math.max(this.span[0], Math.min(this.span[1] - width, from + share * width));
        this.zoom(start, start + width);
      };
      const length = (seconds) => {
        const [from, to] = this.shown, width = Math.min(seconds, this.span[1] - this.span[0]);
        const centre = this.now !== null && this.now >= from && this.now <= to ? this.now : (from + to) / 2;
        const start = Math.max(this.span[0], Math.min(this.span[1] - width, centre - width / 2));
        this.zoom(start, start + width);
      };
      const button = (text, title, onclick) => element("button", { type: "button", title, onclick }, text);
      host.append(
        button("‹", "earlier", () => step(-0.5)), button("›", "later", () => step(0.5)),
        button("day", "show one day", () => length(DAY)),
        ...(this.span[1] - this.span[0] > 4 * DAY ? [button("3 days", "show three days", () => length(3 * DAY))] : []),
        button("all", "show all of it (double click in a chart does so, too)", () => this.zoom()),
      );
    }
  };
})();
