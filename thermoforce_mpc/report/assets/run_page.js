/* The report of a run: draw what its data hold. `Report` is there for whoever looks closer, and for tests. */
"use strict";

Theme.offer(Page.byId("theme"));
const Report = (() => {
  const course = CourseView.draw();
  const cumulative = CumulativeView.draw(course.group);
  const plans = Run.data.plans ? PlanView.draw(course) : null;
  const others = Run.data.other_levels ? OtherView.draw() : null;
  const status = StatusView.draw(course.group);
  if (Run.data.answers) AnswerView.draw();
  document.documentElement.dataset.drawn = "yes";
  return { course, cumulative, plans, others, status };
})();
