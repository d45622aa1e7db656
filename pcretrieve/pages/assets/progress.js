"use strict";
// The stages of a scan as they end; then the page again, with the answer; then the link to the inspection.
const state = document.getElementById("state"), stages = document.getElementById("stages");
const inspection = document.getElementById("inspection");
const events = new EventSource(inspection.dataset.events);
events.onmessage = (event) => {
  const job = JSON.parse(event.data), hasEnded = job.state === "done" || job.state === "failed";
  if (state) {
    state.textContent = job.state;
    stages.replaceChildren(...job.stages.map(({stage, seconds}) => {
      const line = document.createElement("li");
      line.textContent = stage + " " + seconds.toFixed(2) + " s";
      return line;
    }));
    if (hasEnded) { events.close(); location.reload(); }
  } else if (job.inspection !== "waiting") {
    events.close();
    if (job.inspection === "failed") { inspection.textContent = "The scan could not be inspected."; return; }
    const link = document.createElement("a");
    link.href = inspection.dataset.page;
    link.textContent = "Inspection of the scan";
    inspection.replaceChildren(link);
  }
};
