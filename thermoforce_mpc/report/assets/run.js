/* The run that a report is of: its data unpacked, and what was decided at an instant. */
"use strict";

const Run = (() => {
  const { data, numbers, indexAt, formatted, element } = Page;
  const rows = (packed) => packed.map(numbers);

  /* A controller's course: instants of its blocks and what was measured at their ends. */
  function course(packed) {
    const start = numbers(packed.start_s), duration = numbers(packed.duration_s);
    return {
      name: packed.name, start, end: start.map((t, i) => t + duration[i]), T: rows(packed.T_zone_C), u: rows(packed.u),
      power: rows(packed.power_W), cost: numbers(packed.cost), discomfort: rows(packed.discomfort_Kh),
    };
  }

  const own = course(data.own), others = data.baselines.map(course);
  Object.assign(own, {
    lower: rows(data.own.lower_C), upper: rows(data.own.upper_C), price: rows(data.own.price_per_kWh),
    band: data.own.band_C && data.own.band_C.map(rows), outdoor: numbers(data.own.T_out_C), sun: numbers(data.own.solar_W_m2),
  });
  const span = [own.start[0], own.end[own.end.length - 1]];

  const raw = data.steps;
  const steps = {
    ...raw, time: numbers(raw.time_s), length: numbers(raw.step_s), T: rows(raw.T_zone_C), freeNow: rows(raw.T_free_now_C),
    free: rows(raw.T_free_C), low: rows(raw.T_free_low_C), high: rows(raw.T_free_high_C), forced: rows(raw.T_forced_K),
    ms: numbers(raw.plan_ms), parts: Object.entries(raw.parts_ms).map(([name, packed]) => [name, numbers(packed)]),
  };

  const text = (index) => steps.texts[index];

  /* What was decided at the instant `t`, as lines for the box beside the pointer. */
  function why(t) {
    const i = indexAt(steps.time, t);
    if (i < 0 || t > span[1]) return [];
    const status = steps.statuses[steps.status[i]];
    return [element("div", { class: "tip-why" }, element("b", {}, status), ` ${reason(i)}`)];
  }

  /* The reason of a decision in words: of a refusal, the refusal. */
  function reason(i) {
    const parts = [text(steps.refused[i]) || text(steps.why[i]), text(steps.notes[i])];
    return parts.filter(Boolean).join("; ");
  }

  const few = (names) => names.length < 2;
  /* The name of a zone, actuator or machine where there are several. */
  const zone = (z) => (few(data.names.zones) ? "" : data.names.zones[z]);
  const actuator = (a) => (few(data.names.actuators) ? "level" : data.names.actuators[a]);
  const machine = (m) => (few(data.names.machines) ? "power" : data.names.machines[m]);

  const DASHES = [[6, 3], [2, 3], [10, 3, 2, 3], [4, 2, 1, 2], [12, 4]];
  /* Colour and dash of the number `i` of several of a kind: told apart without colour, too. */
  const style = (i) => ({ colour: `--series-${i % 6}`, dash: i === 0 ? undefined : DASHES[(i - 1) % DASHES.length] });
  const looks = Looks.of([own, ...others].map((course) => course.name));
  /* Colour and dash of a controller. */
  const look = ({ name }) => ({ colour: looks.get(name).colour, dash: looks.get(name).dash });

  return { data, own, others, steps, span, why, reason, text, zone, actuator, machine, style, look, formatted };
})();
