// Asks for a playback that is not there, shows how far it is, and reloads the page when it is made or has failed.

const POLL_MS = 1000;
const LONGEST_POLL_MS = 30000;
const TOO_MANY_REQUESTS = 429;
const SERVER_ERRORS = 500;
const ENDED = new Set(["done", "failed"]);

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
      status.textContent = await reasonOf(asked);
      return;
    }
    form.hidden = true;
  }
  for (let wait = POLL_MS; ; ) {
    const answer = await fetch(player.dataset.playback, { headers: { accept: "application/json" } }).catch(() => null);
    if (answer?.redirected) break; // the session is over: the page leads to the sign-in
    if (answer?.ok) {
      const found = await answer.json();
      if (ENDED.has(found.state)) break;
      show(player, status, found);
      wait = POLL_MS;
    } else if (answer && answer.status < SERVER_ERRORS && answer.status !== TOO_MANY_REQUESTS) {
      status.textContent = `${await reasonOf(answer)} Reload the page to go on.`;
      return;
    } else {
      wait = Math.min(2 * wait, LONGEST_POLL_MS);
    }
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
  window.location.reload();
}

async function reasonOf(answer) {
  return (await answer.json().catch(() => ({}))).detail ?? `The server answered with status ${answer.status}.`;
}

function show(player, status, found) {
  if (status.textContent !== found.text) status.textContent = found.text;
  const bar = player.querySelector("progress");
  bar.hidden = found.state !== "running";
  bar.max = Math.max(1, found.env_steps);
  bar.value = found.env_steps_played;
}
