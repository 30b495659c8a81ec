// Adds the reader's own time to the instants of a schedule, which are in UTC.
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
