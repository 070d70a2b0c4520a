/* What came of a plan, in words and figures above its charts. */
"use strict";

const PlanFacts = (() => {
  const { element, byId, indexAt, formatted, digitsFor, instant, HOUR } = Page;
  const { data, steps } = Run;

  const fact = (name, value) => element("div", { class: "fact" }, element("span", {}, name), element("b", {}, value));

  /* Planned against measured temperature of a zone, at the instants of the plan that have been measured since. */
  function compared(name, at, planned, fan, measured) {
    let sum = 0, inside = 0, count = 0;
    for (let k = 1; k < at.length; k++) {
      const m = indexAt(measured.x, at[k]);
      if (m < 0 || Math.abs(measured.x[m] - at[k]) > 60 || !Number.isFinite(planned[k] - measured.y[m])) continue;
      sum += (planned[k] - measured.y[m]) ** 2;
      inside += measured.y[m] >= fan.low[k] && measured.y[m] <= fan.high[k] ? 1 : 0;
      count += 1;
    }
    return { name, rmse: Math.sqrt(sum / count), share: (100 * inside) / count, count };
  }

  /* The instant `t`, the decision number `i`, and the figures of `compared`. */
  function tell(t, i, hasPlan, figures) {
    const status = steps.statuses[steps.status[i]], facts = [];
    for (const figure of figures.filter((figure) => figure.count)) {
      facts.push(fact(`${figure.name ? `${figure.name}: ` : ""}planned − measured, RMS`, `${formatted(figure.rmse)} K`));
      facts.push(fact("measured inside the 80 % fan", `${formatted(figure.share, 0)} %`));
    }
    byId("plan-facts").replaceChildren(...facts);
    byId("plan-instant").textContent = instant(t);
    byId("plan-status").textContent = status;
    byId("plan-status").style.setProperty("--c", `var(--status-${status})`);
    byId("plan-why").textContent = Run.reason(i) + (hasPlan ? "" : " (there is no plan of this instant)");
  }

  /* Cost of the plan since `t` until the last instant that was measured, and what it was. */
  function tellCost(t, at, cost, cameX, cameY) {
    const last = cameX.length - 1, k = indexAt(at, cameX[last]), hours = Math.round((cameX[last] - t) / HOUR);
    if (k < 1 || !Number.isFinite(cost[k])) return;
    const digits = digitsFor(Math.max(cost[k], cameY[last], 1e-4)) + 1, unit = `${data.currency}/m²`;
    byId("plan-facts").prepend(
      fact(`cost of the ${hours} h measured since, planned`, `${formatted(cost[k], digits)} ${unit}`),
      fact("came", `${formatted(cameY[last], digits)} ${unit}`),
    );
  }

  return { compared, tell, tellCost };
})();
