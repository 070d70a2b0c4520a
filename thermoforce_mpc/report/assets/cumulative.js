/* Cost and discomfort by then, beside the baselines. */
"use strict";

const CumulativeView = (() => {
  const { byId } = Page;
  const { data, own, others } = Run;

  /* Mean of the zones' discomfort, as the KPI has it. */
  const mean = (rows) => rows[0].map((_, i) => rows.reduce((sum, row) => sum + row[i], 0) / rows.length);
  const fromZero = (course, values) => ({ x: [course.start[0], ...course.end], y: [0, ...values] });

  function draw(group) {
    const host = byId("cumulative");
    const all = [own, ...others].map((course) => ({ course, style: { ...Run.look(course), width: course === own ? 2.2 : 1.5 } }));
    const lines = (values, digits, unit) => all.map(({ course, style }, i) => ({
      key: `run-${i}`, name: course.name, ...fromZero(course, values(course)), ...style, digits, unit,
    }));
    const cost = new Chart.Course(host, group, {
      title: "Cost so far", unit: `${data.currency}/m²`, height: 200, fromZero: true,
      lines: lines((course) => course.cost, 4, `${data.currency}/m²`),
    });
    const discomfort = new Chart.Course(host, group, {
      title: "Discomfort so far", unit: "K·h", height: 200, fromZero: true, least: 0.2,
      lines: lines((course) => mean(course.discomfort), 2, "K·h"),
    });
    Chart.legend(byId("cumulative-legend"), [cost, discomfort]);
    return { cost, discomfort };
  }

  return { draw };
})();
