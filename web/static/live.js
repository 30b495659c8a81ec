// Updates the page of a running submission. Without JavaScript the page reloads itself (see the noscript refresh).
"use strict";

(() => {
  const live = document.getElementById("live");
  const announcement = document.getElementById("announcement");
  if (live === null || !live.dataset.events || typeof EventSource === "undefined") return;

  const source = new EventSource(live.dataset.events);

  const show = (event) => {
    const scrolled = live.querySelector("pre.log")?.scrollTop;
    const focused = live.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
    live.innerHTML = event.data;
    const log = live.querySelector("pre.log");
    if (log !== null && scrolled !== undefined) log.scrollTop = scrolled;
    if (focused !== null) live.querySelector(`a[href="${CSS.escape(focused)}"]`)?.focus();
    const state = live.querySelector("[data-state]")?.dataset.state ?? "";
    if (state !== live.dataset.state) {
      live.dataset.state = state;
      announcement.textContent = live.querySelector("[data-state]")?.textContent ?? "";
    }
  };

  source.addEventListener("view", show);
  // The evaluation has ended: title and buttons are outdated too, so reload the page once.
  source.addEventListener("end", () => {
    source.close();
    window.location.reload();
  });
})();
