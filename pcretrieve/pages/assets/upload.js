"use strict";
// A chosen or dropped file becomes the body of one request; the answer names the page of the scan.
const form = document.getElementById("upload"), output = form.querySelector("output");
const input = form.querySelector("input");

async function send(file) {
  output.textContent = "sending " + file.name + " ...";
  try {
    const answer = await fetch("/scans?name=" + encodeURIComponent(file.name), {method: "POST", body: file});
    const told = await answer.json();
    if (answer.ok) location.assign("/scan/" + told.job);
    else output.textContent = told.message;
  } catch (error) {
    output.textContent = "The scan could not be sent: is it too large, or has the server ended?";
  }
}

input.addEventListener("change", () => { if (input.files.length) send(input.files[0]); });
form.addEventListener("submit", (event) => event.preventDefault());
for (const name of ["dragover", "dragleave", "drop"])
  addEventListener(name, (event) => {
    event.preventDefault();
    form.classList.toggle("over", name === "dragover");
    if (name === "drop" && event.dataTransfer.files.length) send(event.dataTransfer.files[0]);
  });
