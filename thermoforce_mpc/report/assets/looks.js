/* What controllers look like: a colour, a dash and a shape each, the same on every page, told apart without colour too. */
"use strict";

const Looks = (() => {
  // Those that ship have places of their own; others take the places that a page leaves, in their order.
  const SHIPPED = ["thermoforce_mpc", "native", "thermostat", "pi", "rc_mpc", "thermoforce_paper", "rc_mpc_paper", "dpc"];
  const COLOURS = ["--planned", "--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-0"];
  const DASHES = [undefined, [6, 3], [2, 3], [10, 3, 2, 3], [4, 2, 1, 2], [12, 4]];
  const SHAPES = ["circle", "square", "up", "diamond", "down", "cross", "plus"];

  /* Looks by name of the controllers of a page. */
  function of(names) {
    const taken = new Set(names.map((name) => SHIPPED.indexOf(name)));
    let free = 0;
    return new Map(names.map((name) => {
      let place = SHIPPED.indexOf(name);
      if (place < 0) {
        while (taken.has(free)) free += 1;
        place = free++;
      }
      return [name, { colour: COLOURS[place % COLOURS.length], dash: DASHES[place % DASHES.length], shape: SHAPES[(place + Math.floor(place / 7)) % 7] }];
    }));
  }

  return { of };
})();
