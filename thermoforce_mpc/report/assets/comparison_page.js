/* The page of a comparison or a sweep. `Report` is there for whoever looks closer, and for tests. */
"use strict";

Theme.offer(Page.byId("theme"));
const Report = (() => {
  const panels = Pareto.draw(Page.byId("pareto"), Page.byId("pareto-legend"), Page.byId("pareto-tools"));
  const paired = Page.data.references.length ? Paired.draw() : null;
  document.documentElement.dataset.drawn = "yes";
  return { panels, paired };
})();
