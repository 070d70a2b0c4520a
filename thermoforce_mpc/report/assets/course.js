/* The course of a run: of each zone the temperature in its comfort band, what the plans said a step ahead in free and
 * forced parts, and the levels; below, power, weather and prices. */
"use strict";

const CourseView = (() => {
  const { element, byId } = Page;
  const { data, own, others, steps, span } = Run;

  /* Values at the ends of steps: a prediction made at the begin of a step is of its end. */
  const ends = steps.time.map((t, i) => t + steps.length[i]);
  const sum = (a, b) => a.map((value, i) => value + b[i]);

  function temperature(host, group, z) {
    const lines = [
      ...others.map((other, i) => ({
        key: `T-${i}`, name: other.name, x: other.end, y: other.T[z], ...Run.look(other), width: 1.1, unit: "°C",
        shown: false, rank: 3,
      })),
      { key: "measured", name: "measured", x: own.end, y: own.T[z], colour: "--measured", width: 1.8, unit: "°C", rank: 0 },
    ];
    if (data.planned) {
      lines.push({
        key: "ahead", name: "planned one step ahead", x: ends, y: sum(steps.free[z], steps.forced[z]),
        colour: "--planned", dash: [3, 3], unit: "°C",
      });
    }
    lines.push(...setPoints(z));
    return new Chart.Course(host, group, {
      title: Run.zone(z), unit: "°C", height: data.names.zones.length > 1 ? 190 : 280, least: 2,
      beside: data.planned && data.names.zones.length === 1, lines,
      bands: [{
        key: "comfort", name: "comfort band", x: own.start, low: own.lower[z], high: own.upper[z], colour: "--comfort", limit: true,
        step: true, digits: 1, unit: "°C",
      }],
    });
  }

  /* Set-points given to the plant's own loops of a zone; far away where a loop is off, they do not set the height. */
  function setPoints(z) {
    if (!own.band) return [];
    const a = data.serves[z].find((actuator) => own.band[0][actuator].some(Number.isFinite));
    if (a === undefined) return [];
    return ["heating", "cooling"].map((name, side) => ({
      key: `set-${name}`, name: `set-point, ${name}`, x: own.start, y: own.band[side][a], step: true, beyond: true,
      colour: side ? "--forced" : "--series-2", dash: [2, 2], width: 1, digits: 1, unit: "°C", rank: 2,
    }));
  }

  function parts(host, group, z) {
    return new Chart.Course(host, group, {
      title: Run.zone(z), unit: "free, °C", right: "forced, K", height: data.names.zones.length > 1 ? 190 : 160, least: 1,
      lines: [
        { key: "free", name: "free part", x: ends, y: steps.free[z], colour: "--free", unit: "°C" },
        {
          key: "forced", name: "forced part", x: ends, y: steps.forced[z], colour: "--forced", dash: [6, 3],
          axis: "right", unit: "K",
        },
      ],
      bands: [{
        key: "fan", name: "free part, 80 % of the forecast", x: ends, low: steps.low[z], high: steps.high[z],
        colour: "--free-fan", unit: "°C",
      }],
    });
  }

  function levels(host, group, z) {
    const served = data.serves[z];
    if (!served.length) return null;
    const signed = served.some((a) => own.u[a].some((u) => u < -0.005));
    const several = data.names.zones.length > 1;
    return new Chart.Course(host, group, {
      title: several ? served.map(Run.actuator).join(", ") : "", unit: signed ? "level, < 0 cools" : "level",
      height: several ? 190 : 110, beside: data.planned && !several, range: signed ? [-1.05, 1.05] : [-0.05, 1.05],
      lines: served.map((a, i) => ({
        key: `u-${a}`, name: Run.actuator(a), x: own.start, y: own.u[a], step: true, ...Run.style(i),
        fill: served.length === 1 ? "--level-fill" : undefined,
      })),
    });
  }

  function surroundings(host, group) {
    const charts = data.names.machines.map((name, m) => new Chart.Course(host, group, {
      title: data.names.machines.length > 1 ? name : "", unit: "power, kW", height: 120, fromZero: true,
      lines: [{
        key: `power-${m}`, name: Run.machine(m), x: own.start, y: own.power[m].map((W) => W / 1000), step: true,
        colour: "--planned", fill: "--planned-fill", unit: "kW", width: 1,
      }],
    }));
    const sunny = own.sun.some((W) => W > 0), sun = {
      key: "sun", name: "sun", x: own.end, y: own.sun, colour: "--sun", fill: "--sun-fill", axis: "right", digits: 0,
      unit: "W/m²", width: 1,
    };
    charts.push(new Chart.Course(host, group, {
      unit: "outdoor, °C", ...(sunny ? { right: "sun, W/m²" } : { beside: true }), height: 120,
      lines: [
        ...(sunny ? [sun] : []),
        { key: "outdoor", name: "outdoor", x: own.end, y: own.outdoor, colour: "--measured", unit: "°C" },
      ],
    }));
    for (const m of data.prices) {
      const lone = data.prices.length === 1;
      charts.push(new Chart.Course(host, group, {
        title: lone ? "" : data.names.machines[m], unit: `${data.currency}/kWh`, height: 100, least: 0.02,
        lines: [{ key: `price-${m}`, name: lone ? "price" : `price of ${data.names.machines[m]}`, x: own.start,
          y: own.price[m], step: true, colour: "--measured", digits: 4, unit: `${data.currency}/kWh` }],
      }));
    }
    return charts;
  }

  /* Draw it all; the group is that of everything over the whole run. */
  function draw() {
    const group = new Group("course", span, Run.why);
    const zones = data.names.zones.map((name, z) => z), rows = byId("course");
    const kinds = [[], [], []];
    for (const z of zones) {
      const row = element("div", { class: zones.length > 1 ? "zone-row" : "zone-row alone" });
      rows.append(row);
      kinds[0].push(temperature(row, group, z));
      if (data.planned) kinds[1].push(parts(row, group, z));
      const level = levels(row, group, z);
      if (level) kinds[2].push(level);
    }
    const around = surroundings(byId("surroundings"), group);
    Chart.legend(byId("course-legend"), [...kinds[0], ...kinds[1], ...(zones.length > 1 ? [] : kinds[2])]);
    group.toolbar(byId("course-tools"));
    return { group, temperatures: kinds[0], parts: kinds[1], levels: kinds[2], around };
  }

  return { draw };
})();
