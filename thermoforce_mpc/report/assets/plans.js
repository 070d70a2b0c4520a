/* Plan against actual: a slider over the instants, the plan made then and what came. */
"use strict";

const PlanView = (() => {
  const { element, numbers, byId, indexAt, instant, HOUR } = Page;
  const { data, own, steps } = Run;
  const BEFORE = 6 * HOUR;

  /* The part of a course between two instants. */
  function cut(x, y, from, to) {
    const first = Math.max(0, indexAt(x, from)), last = indexAt(x, to);
    return { x: x.slice(first, last + 1), y: y.slice(first, last + 1) };
  }

  function draw(course) {
    const packed = data.plans, n = packed.n;
    const plans = {
      time: numbers(packed.time_s), length: numbers(packed.step_s), known: packed.known, cost: numbers(packed.cost),
      free: packed.T_free_C.map(numbers), forced: packed.T_forced_K.map(numbers), low: packed.T_free_low_C.map(numbers),
      high: packed.T_free_high_C.map(numbers), u: packed.u.map(numbers),
    };
    const ahead = {
      x: numbers(packed.ahead.time_s), low: packed.ahead.lower_C.map(numbers), high: packed.ahead.upper_C.map(numbers),
    };
    const horizon = n * plans.length[0];
    const group = new Group("plan", [plans.time[0] - BEFORE, plans.time[0] + horizon], Run.why);
    const zones = data.names.zones.map((name, z) => z);
    const nothing = { x: [], y: [] }, noBand = { x: [], low: [], high: [] };

    /* Comfort bounds of a zone: measured, and beyond its end as the last plan saw them. */
    function bounds(z, from, to) {
      const beyond = Math.max(indexAt(ahead.x, own.start[own.start.length - 1]) + 1, 0);
      const join = (measured, later) => [...measured, ...later.slice(beyond)];
      const x = join(own.start, ahead.x), low = join(own.lower[z], ahead.low[z]), high = join(own.upper[z], ahead.high[z]);
      const first = Math.max(0, indexAt(x, from)), last = indexAt(x, to) + 1;
      return { x: x.slice(first, last), low: low.slice(first, last), high: high.slice(first, last) };
    }

    const temperatures = zones.map((z) => {
      const row = element("div", { class: zones.length > 1 ? "zone-row plan" : "zone-row plan alone" });
      byId("plans").append(row);
      return new Chart.Course(row, group, {
        title: Run.zone(z), unit: "°C", height: zones.length > 1 ? 190 : 280, least: 2, beside: zones.length === 1,
        lines: [
          { key: "plan", name: "planned", ...nothing, colour: "--planned", width: 1.8, unit: "°C" },
          { key: "came", name: "measured", ...nothing, colour: "--measured", width: 1.8, unit: "°C", rank: 0 },
        ],
        bands: [
          { key: "comfort", name: "comfort band", ...noBand, colour: "--comfort", limit: true, step: true, digits: 1, unit: "°C" },
          { key: "fan", name: "planned, 80 % of the forecast", ...noBand, colour: "--planned-fan", unit: "°C" },
        ],
      });
    });
    const parts = zones.map((z) => new Chart.Course(byId("plans").children[z], group, {
      title: Run.zone(z), unit: "free, °C", right: "forced, K", height: zones.length > 1 ? 190 : 160, least: 1,
      lines: [
        { key: "free", name: "free part", ...nothing, colour: "--free", unit: "°C" },
        { key: "forced", name: "forced part", ...nothing, colour: "--forced", dash: [6, 3], axis: "right", unit: "K" },
      ],
      bands: [{ key: "free-fan", name: "free part, 80 % of the forecast", ...noBand, colour: "--free-fan", unit: "°C" }],
    }));
    const levels = zones.map((z) => {
      const served = data.serves[z];
      if (!served.length) return null;
      const several = served.length > 1;
      const signed = served.some((a) => own.u[a].some((u) => u < -0.005) || plans.u[a].some((u) => u < -0.005));
      return new Chart.Course(byId("plans").children[z], group, {
        title: zones.length > 1 ? served.map(Run.actuator).join(", ") : "", unit: signed ? "level, < 0 cools" : "level", height: zones.length > 1 ? 190 : 130,
        beside: zones.length === 1,
        range: signed ? [-1.05, 1.05] : [-0.05, 1.05],
        lines: served.flatMap((a, i) => [
          { key: `u-came-${a}`, name: several ? `${Run.actuator(a)}, came` : "level, came", ...nothing, step: true, colour: "--measured",
            dash: several ? Run.style(i).dash : undefined, fill: several ? undefined : "--level-fill" },
          { key: `u-plan-${a}`, name: several ? `${Run.actuator(a)}, planned` : "level, planned", ...nothing, step: true,
            colour: several ? Run.style(i + 1).colour : "--planned", dash: several ? Run.style(i).dash : undefined, width: 1.8 },
        ]),
      });
    });
    const costs = new Chart.Course(byId("plan-cost"), group, {
      unit: `${data.currency}/m²`, height: 130, fromZero: true, beside: zones.length === 1,
      lines: [
        { key: "cost-plan", name: "cost, planned", ...nothing, colour: "--planned", width: 1.8, digits: 4, unit: `${data.currency}/m²` },
        { key: "cost-came", name: "cost, came", ...nothing, colour: "--measured", width: 1.8, digits: 4, unit: `${data.currency}/m²` },
      ],
    });

    /* Show the plan number `p`. */
    function show(p) {
      const t = plans.time[p], h = plans.length[p], end = t + n * h, i = indexAt(steps.time, t);
      const at = Array.from({ length: n + 1 }, (_, k) => t + k * h);
      const part = (values, now) => [now, ...values.subarray(p * n, (p + 1) * n)];
      const hasPlan = plans.known[p];
      const figures = [];
      group.now = t;
      for (const z of zones) {
        const measured = cut(own.end, own.T[z], t - BEFORE, end);
        const updates = { comfort: bounds(z, t - BEFORE, end), came: measured, plan: nothing, fan: noBand };
        const split = { free: nothing, forced: nothing, "free-fan": noBand };
        if (hasPlan) {
          const T = steps.T[z][i], freeNow = steps.freeNow[z][i];
          const free = part(plans.free[z], freeNow), forced = part(plans.forced[z], T - freeNow);
          const add = (values) => part(values, freeNow).map((value, k) => value + forced[k]);
          const planned = free.map((value, k) => value + forced[k]);
          Object.assign(updates, {
            plan: { x: at, y: planned }, fan: { x: at, low: add(plans.low[z]), high: add(plans.high[z]) },
          });
          Object.assign(split, {
            free: { x: at, y: free }, forced: { x: at, y: forced },
            "free-fan": { x: at, low: part(plans.low[z], freeNow), high: part(plans.high[z], freeNow) },
          });
          figures.push(PlanFacts.compared(Run.zone(z), at, planned, updates.fan, measured));
        }
        temperatures[z].update(updates);
        parts[z].update(split);
        const changed = {};
        for (const a of data.serves[z]) {
          changed[`u-came-${a}`] = cut(own.start, own.u[a], t - BEFORE, end);
          const u = plans.u[a].subarray(p * n, (p + 1) * n);
          changed[`u-plan-${a}`] = hasPlan ? { x: at, y: [...u, u[n - 1]] } : nothing;
        }
        if (levels[z]) levels[z].update(changed);
      }
      const cost = hasPlan ? part(plans.cost, 0) : [];
      const before = indexAt(own.end, t), spent = before < 0 ? 0 : own.cost[before];
      const since = cut(own.end, own.cost, t + 1, end);
      const cameX = [t, ...since.x.filter((x) => x > t + 1)];
      const cameY = [0, ...Array.from(since.y).filter((_, k) => since.x[k] > t + 1).map((y) => y - spent)];
      costs.update({ "cost-plan": hasPlan ? { x: at, y: cost } : nothing, "cost-came": { x: cameX, y: cameY } });
      group.move([t - BEFORE, end]);
      course.group.mark(t);
      PlanFacts.tell(t, i, hasPlan, figures);
      if (hasPlan) PlanFacts.tellCost(t, at, cost, cameX, cameY);
    }

    Chart.legend(byId("plan-legend"), [...temperatures, ...parts, ...(zones.length > 1 ? [] : levels.filter(Boolean))]);
    const slider = byId("plan-slider");
    slider.max = plans.time.length - 1;
    /* One drawing per frame, however fast the slider moves. */
    let waiting = null;
    const choose = (p) => {
      slider.value = Math.max(0, Math.min(plans.time.length - 1, p));
      slider.setAttribute("aria-valuetext", instant(plans.time[slider.value]));
      if (waiting === null) {
        waiting = requestAnimationFrame(() => { waiting = null; show(Number(slider.value)); });
      }
    };
    const play = byId("plan-play");
    let playing = null;
    const stop = () => { clearInterval(playing); playing = null; play.textContent = "▶"; play.title = "play"; };
    slider.addEventListener("input", () => choose(Number(slider.value)));
    byId("plan-back").addEventListener("click", () => choose(Number(slider.value) - 1));
    byId("plan-on").addEventListener("click", () => choose(Number(slider.value) + 1));
    play.addEventListener("click", () => {
      if (playing !== null) { stop(); return; }
      play.textContent = "❚❚";
      play.title = "stop";
      playing = setInterval(() => {
        if (Number(slider.value) >= plans.time.length - 1) stop(); else choose(Number(slider.value) + 1);
      }, 200);
    });
    course.group.onPick = (t) => choose(indexAt(plans.time, t));
    /* The first plan of the second day: by then corrections have begun, and a day and more is to come. */
    slider.value = Math.max(0, indexAt(plans.time, plans.time[0] + Math.min(24 * HOUR, 0.25 * (Run.span[1] - Run.span[0]))));
    show(Number(slider.value));
    return { group, temperatures, parts, levels, costs, plans, show };
  }

  return { draw };
})();
