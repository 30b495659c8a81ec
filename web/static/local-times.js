// Adds the reader's own time to the instants of a schedule, which are in UTC.
"use strict";

for (const element of document.querySelectorAll(".schedule time")) {
  const moment = new Date(element.dateTime);
  const local = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "short", timeZoneName: "short" });
  const shown = document.createElement("span");
  shown.className = "sub";
  shown.textContent = local.format(moment);
  element.after(shown);
}
