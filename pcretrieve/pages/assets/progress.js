"use strict";
// The stages of a scan as they end; then the page again, with the answer.
const state = document.getElementById("state"), stages = document.getElementById("stages");
const events = new EventSource(state.dataset.events);
events.onmessage = (event) => {
  const job = JSON.parse(event.data);
  state.textContent = job.state;
  stages.replaceChildren(...job.stages.map(({stage, seconds}) => {
    const line = document.createElement("li");
    line.textContent = stage + " " + seconds.toFixed(2) + " s";
    return line;
  }));
  if (job.state === "done" || job.state === "failed") { events.close(); location.reload(); }
};
