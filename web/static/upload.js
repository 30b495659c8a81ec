// Shows how far an upload is. Without JavaScript the browser sends the same form by itself.
"use strict";

(() => {
  const form = document.getElementById("upload");
  const wrong = document.getElementById("upload-wrong");
  const progress = document.getElementById("upload-progress");
  const bar = document.getElementById("upload-bar");
  const state = document.getElementById("upload-state");
  const button = form.querySelector("button");
  const mebibytes = (count) => (count / 1048576).toFixed(1);

  const codeOf = (text) => Object.assign(document.createElement("code"), { textContent: text });

  const refuse = (sentence) => {
    wrong.replaceChildren(...sentence.split("`").map((part, at) => (at % 2 ? codeOf(part) : part)));
    wrong.hidden = false;
    progress.hidden = true;
    button.disabled = false;
  };

  // A file may be dropped anywhere on the form.
  const input = form.elements.file;
  const zone = document.getElementById("drop");
  for (const kind of ["dragenter", "dragover"]) {
    form.addEventListener(kind, (event) => {
      if (![...event.dataTransfer.types].includes("Files")) return;
      event.preventDefault();
      zone.classList.add("over");
    });
  }
  form.addEventListener("dragleave", (event) => form.contains(event.relatedTarget) || zone.classList.remove("over"));
  form.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    const { files, items } = event.dataTransfer;
    const isFolder = [...items].some((item) => item.webkitGetAsEntry?.()?.isDirectory);
    if (isFolder) refuse("This is a folder; pack it as a zip first, or use `vitac submit FOLDER`.");
    else if (files.length !== 1) refuse(`Drop one file, got ${files.length}.`);
    else {
      wrong.hidden = true;
      input.files = files;
    }
  });

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    wrong.hidden = true;
    progress.hidden = false;
    button.disabled = true;
    const request = new XMLHttpRequest();
    let told = -1;
    request.upload.addEventListener("progress", (sent) => {
      const percent = Math.floor((100 * sent.loaded) / sent.total);
      bar.value = percent;
      if (percent === 100) state.textContent = "Checking the file";
      else if (percent >= told + 10) {
        told = percent;
        state.textContent = `${mebibytes(sent.loaded)} of ${mebibytes(sent.total)} MiB`;
      }
    });
    request.addEventListener("load", () => {
      if (request.status === 200) {
        window.location.assign(request.responseURL);
        return;
      }
      let detail = `The server answered with ${request.status}.`;
      try {
        detail = JSON.parse(request.responseText).detail || detail;
      } catch {
        // No problem document: the status says it.
      }
      refuse(detail);
    });
    request.addEventListener("error", () => refuse("The connection was cut. Try again; from a terminal an upload goes on where it was cut."));
    request.open("POST", form.action);
    request.setRequestHeader("Accept", "application/json");
    request.send(new FormData(form));
  });
})();
