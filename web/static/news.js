// The front page: what has happened meanwhile appears by itself as long as somebody looks.
"use strict";

(() => {
  const LOOK_MS = 15000;

  let shown;

  const look = async () => {
    const news = document.getElementById("news");
    if (document.hidden || news.contains(document.activeElement)) return;
    const answer = await fetch("/", { headers: { accept: "text/html" } }).catch(() => null);
    if (!answer?.ok) return;
    const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").getElementById("news").innerHTML;
    if (fresh !== shown) news.innerHTML = fresh;
    shown = fresh;
  };

  setInterval(look, LOOK_MS);
})();
