// Writes times in the reader's own zone and decimals in the reader's own way; a deadline keeps its UTC time, and its countdown runs.
"use strict";

(() => {
  const { locale, timeZone } = Intl.DateTimeFormat().resolvedOptions();
  const parts = { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" };
  const plain = new Intl.DateTimeFormat(undefined, parts);
  const zoned = new Intl.DateTimeFormat(undefined, { ...parts, timeZoneName: "short" });
  const separator = new Intl.NumberFormat(locale).formatToParts(0.5).find(({ type }) => type === "decimal").value;
  const DECIMAL = /(?<![\w.])(\d+)\.(\d+)(?![\w.])/g;
  const AS_WRITTEN = "code, pre, .mono, .document, textarea, script, time, .player, .players";

  const showTime = (element) => {
    const moment = new Date(element.dateTime);
    if (element.classList.contains("deadline")) {
      const own = document.createElement("span");
      own.className = "sub";
      own.textContent = `(${zoned.format(moment)})`;
      element.after(" ", own);
    } else {
      element.title = element.textContent;
      element.textContent = plain.format(moment);
    }
  };

  const showNumbers = (part) => {
    const texts = document.createTreeWalker(part, NodeFilter.SHOW_TEXT);
    while (texts.nextNode()) {
      const text = texts.currentNode;
      if (text.data.includes(".") && !text.parentElement.closest(AS_WRITTEN)) {
        text.data = text.data.replace(DECIMAL, `$1${separator}$2`);
      }
    }
  };

  const isUtc = /^(Etc\/)?(UTC|GMT|Universal|Zulu)$/.test(timeZone);
  const show = (part) => {
    if (!isUtc) part.querySelectorAll("time[datetime]").forEach(showTime);
    if (separator !== ".") showNumbers(part);
  };
  show(document.getElementById("main"));
  if (!isUtc) document.getElementById("zone").textContent = `Times are yours (${timeZone}); deadlines are in UTC, too.`;
  // What comes later is as the server wrote it; changes below the first level are our own.
  for (const part of document.querySelectorAll("#live, #news")) {
    new MutationObserver(() => show(part)).observe(part, { childList: true });
  }

  // As `remaining` in `web/rendering.py` formats it.
  const remaining = (seconds) => {
    const minutes = Math.max(0, Math.floor(seconds / 60));
    const days = Math.floor(minutes / 1440);
    const hours = Math.floor(minutes / 60) % 24;
    if (days > 0) return `${days} ${days === 1 ? "day" : "days"} ${hours} h`;
    return hours > 0 ? `${hours} h ${String(minutes % 60).padStart(2, "0")} min` : `${minutes} min`;
  };

  const countDown = () => {
    for (const element of document.querySelectorAll("[data-until]")) {
      element.textContent = remaining((new Date(element.dataset.until) - Date.now()) / 1000);
    }
  };

  if (document.querySelector("[data-until]") !== null) setInterval(countDown, 20000);
})();
