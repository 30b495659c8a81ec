// Shows the newest live picture of each station, and keeps what stands around it up to date until the trials are over.
const PERIOD_MS = 1000, PAGE_PERIOD_MS = 10_000;

function watch(image) {
  const next = image.cloneNode();
  const show = (isThere) => {
    next.hidden = !isThere;
    next.closest("figure").querySelector("[data-waiting]").hidden = isThere;
    setTimeout(watch, PERIOD_MS, next);
  };
  // The picture before stays until the next one is there.
  next.addEventListener("load", () => { image.replaceWith(next); show(true); });
  next.addEventListener("error", () => { image.replaceWith(next); show(false); });
  next.src = `${image.dataset.live}?${Date.now()}`;
}

async function renew() {
  const page = await fetch(location.href).then((answer) => answer.text()).catch(() => "");
  const parts = new DOMParser().parseFromString(page, "text/html").querySelectorAll("[data-renewed]");
  const shown = document.querySelectorAll("[data-renewed]");
  if (parts.length === shown.length) shown.forEach((part, index) => { part.textContent = parts[index].textContent; });
  else if (parts.length) location.reload();
  setTimeout(renew, PAGE_PERIOD_MS);
}

document.querySelectorAll("[data-live]").forEach(watch);
setTimeout(renew, PAGE_PERIOD_MS);
