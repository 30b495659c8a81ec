// Makes each map of episodes one stop of the Tab key, in which the arrow keys move from episode to episode.
"use strict";

(() => {
  const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const CELL = 10;

  const place = (link) => ["x", "y"].map((name) => Math.floor(link.querySelector("rect")[name].baseVal.value / CELL));

  const keepOneStop = () => {
    for (const map of document.querySelectorAll("svg.map")) {
      const links = [...map.querySelectorAll("a")];
      const current = links.find((link) => link === document.activeElement) ?? links[0];
      for (const link of links) link.setAttribute("tabindex", link === current ? "0" : "-1");
    }
  };

  document.addEventListener("focusin", (event) => {
    if (event.target.closest?.("svg.map")) keepOneStop();
  });
  document.addEventListener("keydown", (event) => {
    const link = event.target.closest?.("svg.map a");
    if (!link || !(event.key in STEPS)) return;
    event.preventDefault();
    const [across, down] = STEPS[event.key];
    const [column, row] = place(link);
    const links = [...link.closest("svg").querySelectorAll("a")];
    const ahead = links
      .map((other) => ({ other, at: place(other) }))
      .filter(({ at }) => (across ? at[1] === row && (at[0] - column) * across > 0 : at[0] === column && (at[1] - row) * down > 0))
      .sort((one, two) => Math.hypot(one.at[0] - column, one.at[1] - row) - Math.hypot(two.at[0] - column, two.at[1] - row));
    ahead[0]?.other.focus();
  });

  const live = document.getElementById("live");
  if (live) new MutationObserver(keepOneStop).observe(live, { childList: true });
  keepOneStop();
})();
