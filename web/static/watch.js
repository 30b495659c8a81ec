// Shows the newest live picture of each station; one that is not there yet is asked for again.
const PERIOD_MS = 1000;

for (const image of document.querySelectorAll("[data-live]")) {
  const address = image.getAttribute("src");
  const ask = () => setTimeout(() => { image.src = `${address}?${Date.now()}`; }, PERIOD_MS);
  image.addEventListener("load", ask);
  image.addEventListener("error", ask);
  if (image.complete) ask();
}
