// The front page: loads the 3D player, which is large, when somebody wants to play the episode.

const button = document.getElementById("play-example");
const controls = document.querySelector("form.transport");

// The player shows its controls when it is ready.
new MutationObserver((_, observer) => {
  observer.disconnect();
  controls.elements.play.focus();
  controls.elements.play.click();
}).observe(controls, { attributes: true, attributeFilter: ["hidden"] });

button.hidden = false;
button.addEventListener("click", () => {
  button.disabled = true;
  const script = document.createElement("script");
  script.type = "module";
  script.src = button.dataset.script;
  script.addEventListener("load", () => button.remove());
  script.addEventListener("error", () => {
    button.disabled = false;
  });
  document.head.append(script);
});
