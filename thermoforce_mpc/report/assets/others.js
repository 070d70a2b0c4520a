/* Other levels: what the model says the day would have been with all actuators off, at half or full level. */
"use strict";

const OtherView = (() => {
  const { numbers, byId, element, indexAt, formatted, instant } = Page;
  const { data, own } = Run;
  // Half width of a 90 % band of a normal distribution, standard deviations.
  const BAND = 1.645;
  const COLOURS = { off: ["--series-1", "--series-1-fan"], half: ["--series-3", "--series-3-fan"], full: ["--planned", "--planned-fan"] };

  function draw() {
    const packed = data.other_levels, n = packed.n, h = packed.step_s;
    const time = numbers(packed.time_s);
    const rows = (of) => of.map((level) => level.map(numbers));
    const T = rows(packed.T_other_C), sd = rows(packed.sd_K);
    const group = new Group("other", [time[0], time[0] + n * h], Run.why);
    const zones = data.names.zones.map((name, z) => z), empty = { x: [], y: [] }, noBand = { x: [], low: [], high: [] };
    const charts = zones.map((z) => new Chart.Course(byId("others"), group, {
      title: Run.zone(z), unit: "°C", height: zones.length > 1 ? 200 : 280, least: 2,
      bands: [
        { key: "comfort", name: "comfort band", ...noBand, colour: "--comfort", limit: true, step: true, digits: 1, unit: "°C" },
        ...packed.levels.map((name) => ({
          key: `band-${name}`, name: `${name}, 90 %`, ...noBand, colour: COLOURS[name][1], unit: "°C",
        })),
      ],
      lines: [
        ...packed.levels.map((name, i) => ({
          key: `other-${name}`, name: `all ${name === "half" ? "at half" : name === "full" ? "at full level" : "off"}`,
          ...empty, colour: COLOURS[name][0], dash: [[6, 3], [2, 3], [10, 3, 2, 3]][i], width: 1.8, unit: "°C",
        })),
        { key: "came", name: "measured", ...empty, colour: "--measured", width: 1.8, unit: "°C", rank: 0 },
      ],
    }));

    function show(p) {
      const t = time[p], end = t + n * h, at = Array.from({ length: n }, (_, k) => t + (k + 1) * h);
      for (const z of zones) {
        const first = indexAt(own.end, t), last = indexAt(own.end, end) + 1;
        const changed = {
          came: { x: own.end.slice(first, last), y: own.T[z].slice(first, last) },
          comfort: { x: own.start.slice(first, last), low: own.lower[z].slice(first, last), high: own.upper[z].slice(first, last) },
        };
        const now = own.T[z][first];
        packed.levels.forEach((name, l) => {
          const y = T[l][z].subarray(p * n, (p + 1) * n), half = sd[l][z].subarray(p * n, (p + 1) * n).map((s) => BAND * s);
          changed[`other-${name}`] = { x: [t, ...at], y: [now, ...y] };
          changed[`band-${name}`] = { x: [t, ...at], low: [now, ...y.map((v, k) => v - half[k])], high: [now, ...y.map((v, k) => v + half[k])] };
        });
        charts[z].update(changed);
      }
      group.move([t, end]);
      byId("other-instant").textContent = `the day after ${instant(t)}`;
      const energy = [["as it was", packed.energy_applied_kWh[p]], ...packed.levels.map((name, l) => [`all ${name}`, packed.energy_kWh[l][p]])];
      byId("other-facts").replaceChildren(...energy.filter(([, kWh]) => kWh !== null).map(([name, kWh]) => element(
        "div", { class: "fact" }, element("span", {}, `energy by the model, ${name}`), element("b", {}, `${formatted(kWh, 1)} kWh`),
      )));
    }

    Chart.legend(byId("other-legend"), charts);
    const slider = byId("other-slider");
    slider.max = time.length - 1;
    slider.addEventListener("input", () => show(Number(slider.value)));
    show(0);
    return { charts, group, show };
  }

  return { draw };
})();
