/* Ground of all pages: the data that travel in the page, words for numbers and times, elements, colours. */
"use strict";

const Page = (() => {
  const HOUR = 3600, DAY = 86400;

  /* The data of the page; arrays stay packed until `numbers` reads them. */
  const data = JSON.parse(document.getElementById("data").textContent);

  function bytes(text) {
    const raw = atob(text), octets = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) octets[i] = raw.charCodeAt(i);
    return octets.buffer;
  }

  /* The numbers of a packed array (packing.py), NaN where there is none. */
  function numbers(packed) {
    if (packed.as === "float64") return new Float64Array(bytes(packed.data));
    if (packed.as === "float32") return Float64Array.from(new Float32Array(bytes(packed.data)));
    if (packed.as === "changes") return summed(packed);
    const raw = bytes(packed.data), codes = packed.as === "int8" ? new Int8Array(raw) : new Int16Array(raw);
    const nothing = packed.as === "int8" ? -128 : -32768, values = new Float64Array(codes.length);
    for (let i = 0; i < codes.length; i++) {
      values[i] = codes[i] === nothing ? NaN : packed.low + (codes[i] - nothing - 1) * packed.step;
    }
    return values;
  }

  /* Courses told by their starts and changes, one after the other. */
  function summed(packed) {
    const starts = numbers(packed.starts), changes = new Int8Array(bytes(packed.data));
    const n = changes.length / starts.length + 1, courses = new Float64Array(starts.length * n);
    for (let p = 0; p < starts.length; p++) {
      courses[p * n] = starts[p];
      for (let k = 1; k < n; k++) courses[p * n + k] = courses[p * n + k - 1] + changes[p * (n - 1) + k - 1] * packed.step;
    }
    return courses;
  }

  /* Index of the last of `x` (ascending) that is not after `t`; -1 before the first. */
  function indexAt(x, t) {
    let low = 0, high = x.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (x[middle] <= t + 1e-6) low = middle + 1; else high = middle;
    }
    return low - 1;
  }

  /* A number for people: `digits` after the point, a true minus sign, a dash where there is none. */
  function formatted(value, digits = 2) {
    if (value === null || value === undefined || !Number.isFinite(value)) return "–";
    const text = value.toFixed(digits);
    return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
  }

  /* Digits after the point that show about three figures of a range. */
  const digitsFor = (range) => Math.max(0, Math.min(5, 2 - Math.floor(Math.log10(Math.max(range, 1e-9)))));

  /* Seconds on the clock of the building since the midnight before its time 0. */
  function wall(t) {
    if (!data.dates) return t;
    const { from, shift } = data.dates;
    return t + shift[Math.max(0, indexAt(from, t))];
  }

  const clock = (t) => {
    const minutes = Math.round((wall(t) % DAY) / 60);
    return `${String(Math.floor(minutes / 60) % 24).padStart(2, "0")}:${String(minutes % 60).padStart(2, "0")}`;
  };

  const dayOf = (t) => Math.floor((wall(t) + 1e-6) / DAY);

  /* The calendar day of an instant; without dates of a year without 29 February. */
  const MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split(" ");
  const WEEKDAYS = "Sun Mon Tue Wed Thu Fri Sat".split(" ");
  function calendar(t) {
    const date = new Date(Date.parse(data.dates ? data.dates.began : "2021-01-01") + dayOf(t) * DAY * 1000);
    const day = `${date.getUTCDate()} ${MONTHS[date.getUTCMonth()]}`;
    return data.dates ? `${WEEKDAYS[date.getUTCDay()]} ${day}` : day;
  }

  /* A day as a label: its date where the run has dates, else as `tf-mpc explain` writes it, from 0. */
  const day = (t) => (data.dates ? calendar(t).slice(4) : `day ${dayOf(t)}`);
  const instant = (t) => (data.dates ? `${calendar(t)} ${clock(t)}` : `${day(t)} ${clock(t)} (${calendar(t)})`);

  /* Round numbers that divide a range into four or more. */
  function ticks(low, high) {
    const raw = (high - low) / 4, size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5].map((k) => k * size).filter((k) => k <= raw * 1.0001).pop();
    const marks = [];
    for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + 1e-9; at += step) marks.push(at);
    return marks;
  }

  /* Digits after the point that tell round numbers apart. */
  const digitsOf = (marks) => Math.max(0, ...marks.slice(1).map((at, i) => Math.ceil(-Math.log10(at - marks[i]) - 1e-9)));

  /* An element with attributes and children; text is always text, never markup. */
  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
      else if (value === true) made.setAttribute(key, "");
      else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value);
    }
    made.append(...children.filter((child) => child !== null && child !== undefined));
    return made;
  }

  /* An element of a drawing. */
  function drawn(name, attributes = {}, ...children) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  const byId = (id) => document.getElementById(id);

  return { HOUR, DAY, data, numbers, indexAt, ticks, digitsOf, formatted, digitsFor, wall, clock, day, instant, element, drawn, byId };
})();
