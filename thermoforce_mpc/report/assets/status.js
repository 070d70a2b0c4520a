/* Who acted at each step, rung by rung of the ladder, and how long the solver took. */
"use strict";

const StatusView = (() => {
  const { element, byId, indexAt, formatted } = Page;
  const { data, steps } = Run;

  /* The statuses that occur, in the order of the ladder, with their numbers in the data. */
  const rungs = [...new Set([...steps.status, ...steps.acting.flat()])].sort((a, b) => a - b);

  function lanes(host, group, codes, title) {
    const last = rungs.length - 1, width = Math.min(110, 26 + 7 * Math.max(...rungs.map((r) => steps.statuses[r].length)));
    const chart = new Chart.Course(host, group, {
      title, height: 44 + 20 * rungs.length, range: [-0.6, last + 0.6],
      ticks: { size: width, splits: () => rungs.map((_, i) => last - i),
        values: () => rungs.map((code) => steps.statuses[code]), grid: { show: false } },
      lines: [{ key: "status", name: title || "status", x: steps.time, y: codes.map(() => NaN), colour: "--measured",
        silent: true }],
      tip: (t) => {
        const i = indexAt(steps.time, t);
        return [...(title && i >= 0 ? [acted(title, codes[i])] : []), ...solver(i)];
      },
      paint: (plot) => paint(plot, codes),
    });
    chart.codes = codes;
    return chart;
  }

  /* Steps as boxes: a lane per rung says which, its colour says it again. */
  function paint(plot, codes) {
    const { ctx, bbox } = plot, last = rungs.length - 1;
    const height = Math.abs(plot.valToPos(0, "y", true) - plot.valToPos(1, "y", true)) * 0.62;
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (let i = 0; i < codes.length; i++) {
      let j = i;
      while (j + 1 < codes.length && codes[j + 1] === codes[i]) j += 1;
      const left = plot.valToPos(steps.time[i], "x", true);
      const right = plot.valToPos(steps.time[j] + steps.length[j] * steps.every, "x", true);
      const y = plot.valToPos(last - rungs.indexOf(codes[i]), "y", true);
      ctx.fillStyle = Theme.colour(`--status-${steps.statuses[codes[i]]}`);
      ctx.fillRect(left, y - height / 2, Math.max(right - left, 1.5 * devicePixelRatio), height);
      i = j;
    }
  }

  /* Who acted at an actuator, as a line of the box. */
  function acted(name, code) {
    const status = steps.statuses[code];
    return Tip.entry(`--status-${status}`, name, status);
  }

  /* The solver at a step, as a line of the box. */
  function solver(i) {
    if (i < 0) return [];
    const name = Run.text(steps.solver[i]);
    const lines = [Tip.entry("--measured", "computing time", `${formatted(steps.ms[i], 1)} ms`)];
    if (name) lines.push(Tip.entry("--planned", name, steps.iterations[i] ? `${steps.iterations[i]} iterations` : ""));
    return lines;
  }

  function times(host, group) {
    const lines = [{ key: "ms", name: "in all", x: steps.time, y: steps.ms, colour: "--measured", step: true, digits: 1, unit: "ms" }];
    steps.parts.forEach(([name, ms], i) => lines.push({
      key: `ms-${name}`, name, x: steps.time, y: ms, ...Run.style(i + 1), step: true, digits: 1, unit: "ms", width: 1,
    }));
    return new Chart.Course(host, group, {
      title: "Computing time of each step", unit: "ms", height: 150, fromZero: true, lines,
      tip: (t) => solver(indexAt(steps.time, t)).slice(1),
    });
  }

  function draw(group) {
    const host = byId("status"), several = data.names.actuators.length > 1;
    const charts = several
      ? data.names.actuators.map((name, a) => lanes(host, group, steps.acting[a], name))
      : [lanes(host, group, steps.status, "")];
    const computing = times(byId("computing"), group);
    Chart.legend(byId("computing-legend"), [computing]);
    return { lanes: charts, computing, rungs: rungs.map((code) => steps.statuses[code]) };
  }

  return { draw };
})();
