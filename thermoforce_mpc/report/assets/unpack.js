/* Unpack the data of the page, then run the scripts that wait for them, in order. */
"use strict";

(async () => {
  const island = document.getElementById("data");
  const octets = Uint8Array.from(atob(island.textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([octets]).stream().pipeThrough(new DecompressionStream("gzip"));
  island.textContent = await new Response(stream).text();
  for (const waiting of document.querySelectorAll("script[type='text/waiting']")) {
    const script = document.createElement("script");
    script.textContent = waiting.textContent;
    waiting.replaceWith(script);
  }
})();
