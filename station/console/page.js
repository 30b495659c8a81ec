// The console of a station: shows what the cameras and the force sensor say now, and sends what operators decide.
const PERIOD_MS = 250;
const SHOWN_S = 30;
const LENGTHENED = 4;
const LOST_MS = 2000;
const NAMES = { left: "Left gel", right: "Right gel", overview: "Platform" };
const WORDS = { accept: "Accept", refuse: "Refuse", regrasp: "Grasp again" };
const at = (id) => document.getElementById(id);
const forces = [];
let state = null;
let asked = 0;
let heardAt = performance.now();

async function ask(what, content = {}) {
  const answer = await fetch(what, { method: "POST", body: JSON.stringify(content) });
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
}

async function send(what, content) {
  try {
    state = await ask(what, content);
    at("alert").textContent = "";
    show();
  } catch (error) {
    at("alert").textContent = error.message;
  }
}

async function look() {
  try {
    state = await ask("state");
    heardAt = performance.now();
    forces.push([heardAt / 1000, state.force_n]);
    while (forces.length && forces[0][0] < heardAt / 1000 - SHOWN_S) forces.shift();
    show();
  } catch {
    if (performance.now() - heardAt > LOST_MS) {
      at("alert").textContent = "The agent of the station does not answer. Use the emergency stop, then look at its terminal.";
    }
  }
  setTimeout(look, PERIOD_MS);
}

function show() {
  at("title").textContent = `Station ${state.station}${state.twin ? `: ${state.twin}` : ""}`;
  at("phase").textContent = state.stopped ?? state.reason ?? (state.paused_s === null ? state.phase : `Paused for ${Math.round(state.paused_s)} s.`);
  at("pause").textContent = state.paused_s === null ? "Pause" : "Go on";
  at("stop").disabled = state.stopped !== null;
  at("next").hidden = Object.keys(state.about).length === 0;
  fill(at("about"), Object.entries(state.about).filter(([, value]) => value !== null), ([name, value]) => {
    const [term, meaning] = [document.createElement("dt"), document.createElement("dd")];
    [term.textContent, meaning.textContent] = [name, value];
    return [term, meaning];
  });
  fill(at("help"), state.help, (each) => {
    const line = document.createElement("li");
    line.textContent = each;
    return [line];
  });
  showQuestion();
  showCameras();
  drawForce();
}

function fill(parent, values, make) {
  const text = JSON.stringify(values);
  if (parent.dataset.shown === text) return;
  parent.dataset.shown = text;
  parent.replaceChildren(...values.flatMap(make));
}

function showQuestion() {
  const question = state.question;
  at("question").hidden = question === null;
  if (question === null || question.number === asked) return;
  asked = question.number;
  at("text").textContent = question.text;
  at("measured").textContent = question.measured.join(", ");
  at("checklist").replaceChildren(...question.checklist.map((text) => {
    const [label, box] = [document.createElement("label"), document.createElement("input")];
    label.className = "check";
    box.type = "checkbox";
    box.addEventListener("change", allowAccept);
    label.append(box, text);
    return label;
  }));
  at("decisions").replaceChildren(...question.decisions.map((decision) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = WORDS[decision];
    button.dataset.decision = decision;
    if (decision === "accept") button.className = "go";
    button.addEventListener("click", () => decide(question.number, decision));
    return button;
  }));
  allowAccept();
}

function allowAccept() {
  const isChecked = [...at("checklist").querySelectorAll("input")].every((box) => box.checked);
  at("decisions").querySelector("[data-decision=accept]").disabled = !isChecked;
}

async function decide(number, decision) {
  await send("decide", { number, decision, note: at("note").value });
  if (at("alert").textContent === "") at("note").value = "";
}

function showCameras() {
  fill(at("cameras"), state.cameras, (name) => {
    const figure = document.createElement("figure");
    figure.innerHTML = `<div class="seen"><img alt=""><canvas width="640" height="480"></canvas></div><figcaption></figcaption>`;
    figure.querySelector("img").alt = `${NAMES[name]}, live`;
    figure.querySelector("figcaption").textContent = NAMES[name];
    figure.dataset.camera = name;
    return [figure];
  });
  state.cameras.forEach((name, index) => {
    const figure = at("cameras").querySelector(`[data-camera=${name}]`);
    const image = figure.querySelector("img");
    if (image.complete) image.src = `${name}.jpg?${Math.round(performance.now())}`;
    if (state.markers[index]) drawMarkers(figure.querySelector("canvas"), state.markers[index]);
  });
}

function drawMarkers(canvas, markers) {
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = "#ffd54a";
  pen.lineWidth = 3;
  markers.reference.forEach(([x, y], index) => {
    const [endX, endY] = markers.current[index];
    pen.beginPath();
    pen.moveTo(2 * x, 2 * y);
    pen.lineTo(2 * (x + LENGTHENED * (endX - x)), 2 * (y + LENGTHENED * (endY - y)));
    pen.stroke();
  });
}

function drawForce() {
  const canvas = at("force");
  const pen = canvas.getContext("2d");
  const measured = forces.filter(([, force]) => force !== null);
  const largest = Math.max(5, ...measured.map(([, force]) => force));
  const now = performance.now() / 1000;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = pen.fillStyle = getComputedStyle(canvas).color;
  pen.font = "24px system-ui";
  pen.fillText(`${largest.toFixed(0)} N`, 8, 28);
  pen.lineWidth = 3;
  pen.beginPath();
  measured.forEach(([time, force], index) => {
    const x = canvas.width * (1 - (now - time) / SHOWN_S);
    const y = canvas.height - 6 - (canvas.height - 46) * (force / largest);
    if (index === 0) pen.moveTo(x, y);
    else pen.lineTo(x, y);
  });
  pen.stroke();
  const last = measured.at(-1);
  at("force-title").textContent = last ? `Force, last ${SHOWN_S} s: ${last[1].toFixed(2)} N of at most ${state.limit_n} N` : "Force: not measured";
}

at("pause").addEventListener("click", () => send(state.paused_s === null ? "pause" : "resume"));
at("stop").addEventListener("click", () => send("stop"));
at("write").addEventListener("click", async () => {
  await send("note", { note: at("note").value });
  if (at("alert").textContent === "") at("note").value = "";
});
look();
