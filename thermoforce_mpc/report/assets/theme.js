/* Light or dark: as the system says, or as the switch says; print is always light. Charts ask here for colours.
 * It runs in the head, before anything is seen. */
"use strict";

const Theme = (() => {
  const root = document.documentElement, KEY = "tf-mpc-theme", MODES = ["auto", "light", "dark"];
  const watchers = [];
  let colours = new Map(), printing = false;

  /* What was chosen on an earlier visit; a browser may refuse to remember. */
  function remembered() {
    try { return localStorage.getItem(KEY); } catch { return null; }
  }

  let mode = MODES.includes(remembered()) ? remembered() : "auto";

  const system = matchMedia("(prefers-color-scheme: dark)");

  function apply() {
    const dark = !printing && (mode === "dark" || (mode === "auto" && system.matches));
    root.dataset.theme = dark ? "dark" : "light";
    colours = new Map();
    watchers.forEach((tell) => tell());
  }

  function choose(next) {
    mode = next;
    try { localStorage.setItem(KEY, mode); } catch { /* it lasts as long as the page is open */ }
    apply();
  }

  /* The value of a colour of style.css, such as "--measured", in the present theme. */
  function colour(name) {
    if (!name.startsWith("--")) return name;
    if (!colours.has(name)) colours.set(name, getComputedStyle(root).getPropertyValue(name).trim());
    return colours.get(name);
  }

  /* `tell` is called after each change of theme. */
  const onChange = (tell) => { watchers.push(tell); };

  /* Buttons of the switch in `host`. */
  function offer(host) {
    const buttons = MODES.map((name) => Page.element(
      "button", { type: "button", "data-mode": name, onclick: () => { choose(name); mark(); } }, name,
    ));
    const mark = () => buttons.forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.mode === mode)));
    host.append(...buttons);
    mark();
  }

  system.addEventListener("change", apply);
  addEventListener("beforeprint", () => { printing = true; apply(); });
  addEventListener("afterprint", () => { printing = false; apply(); });
  apply();
  return { colour, onChange, offer };
})();
