// Asks for a playback that is not there, shows how far it is, and reloads the page when it is made or has failed.

const POLL_MS = 1000;
const ENDED = new Set(["made", "failed"]);

export async function followUntilMade(player) {
  const form = player.querySelector("form.ask");
  const status = player.querySelector(".player-status");
  if (form) {
    const asked = await fetch(form.action, {
      method: "POST",
      body: new URLSearchParams(new FormData(form)),
      headers: { accept: "application/json" },
    });
    if (!asked.ok) {
      status.textContent = (await asked.json().catch(() => ({}))).detail ?? `The server answered with status ${asked.status}.`;
      return;
    }
    form.hidden = true;
  }
  for (;;) {
    const answer = await fetch(player.dataset.playback, { headers: { accept: "application/json" } }).catch(() => null);
    if (answer?.ok) {
      const found = await answer.json();
      if (ENDED.has(found.state)) break;
      show(player, status, found);
    }
    await new Promise((resolve) => setTimeout(resolve, POLL_MS));
  }
  window.location.reload();
}

function show(player, status, found) {
  if (status.textContent !== found.text) status.textContent = found.text;
  const bar = player.querySelector("progress");
  bar.hidden = found.state !== "running";
  bar.max = Math.max(1, found.env_steps);
  bar.value = found.env_steps_played;
}
