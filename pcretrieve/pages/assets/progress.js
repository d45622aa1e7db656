"use strict";
// One bar for all stages of a scan, with the name of the present one; then the page again, with the answer; then
// the link to the inspection. A browser connects again by itself; a server that has ended is said.
const state = document.getElementById("state"), bar = document.getElementById("bar");
const inspection = document.getElementById("inspection");
const events = new EventSource(inspection.dataset.events);
// What comes after each stage, and how far that is; meshes have fewer stages than points.
const NEXT = {
  "": [0, "reading"], read: [1, "cutting out the body"], crop: [2, "cleaning"], clean: [3, "finding which side is outside"],
  orient: [4, "growing the surface"], surface: [6, "listening to its tones"], spectrum: [7, "checking"], checks: [8, "searching"],
};
events.onmessage = (event) => {
  const job = JSON.parse(event.data), hasEnded = job.state === "done" || job.state === "failed";
  if (state) {
    const last = job.stages.length ? job.stages[job.stages.length - 1].stage : "", [far, words] = NEXT[last] || [bar.value, last];
    state.textContent = job.state === "waiting" ? "waiting for the scans before it" : words + " …";
    bar.value = far;
    if (hasEnded) { events.close(); location.reload(); }
  } else if (job.inspection !== "waiting") {
    events.close();
    if (job.inspection === "failed") { inspection.textContent = "The scan could not be inspected."; return; }
    if (inspection.dataset.alone) { location.replace(inspection.dataset.page); return; }
    const link = document.createElement("a");
    link.href = inspection.dataset.page;
    link.className = "button quiet";
    link.textContent = "Inspection of the scan";
    inspection.replaceChildren(link);
  }
};
events.onerror = () => {
  if (events.readyState === EventSource.CLOSED) (state || inspection).textContent = "The server has ended: start it again, and send the scan again.";
};
