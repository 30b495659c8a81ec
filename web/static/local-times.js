// Adds the reader's own time to the instants of a schedule, which are in UTC, and counts down to its next ones.
"use strict";

// `timeZoneName` is refused beside `dateStyle`, so each part is named.
const local = new Intl.DateTimeFormat(undefined, {
  year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", timeZoneName: "short",
});

for (const element of document.querySelectorAll(".schedule time")) {
  const moment = new Date(element.dateTime);
  const shown = document.createElement("span");
  shown.className = "sub";
  shown.textContent = local.format(moment);
  element.after(shown);
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
