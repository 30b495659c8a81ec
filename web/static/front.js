// The front page: plays the episode once in 3D when the page is there; for readers who want no motion or save
// data only when they ask for it, as the player is large.

const button = document.getElementById("play-example");
const controls = document.querySelector("form.transport");

// The player shows its controls when it is ready.
new MutationObserver((_, observer) => {
  observer.disconnect();
  if (!button.hidden) controls.elements.play.focus();
  controls.elements.play.click();
}).observe(controls, { attributes: true, attributeFilter: ["hidden"] });

const isCalm = window.matchMedia("(prefers-reduced-motion: reduce)").matches || navigator.connection?.saveData;
button.hidden = !isCalm;
button.addEventListener("click", load);
if (!isCalm) window.addEventListener("load", load);

function load() {
  button.disabled = true;
  const script = document.createElement("script");
  script.type = "module";
  script.src = button.dataset.script;
  script.addEventListener("load", () => button.remove());
  script.addEventListener("error", () => {
    button.disabled = false;
  });
  document.head.append(script);
}
