// Instants are written in UTC; beside them the viewer's own time, where that is another.
function addOwnTimes(part) {
  for (const time of part.querySelectorAll("time[datetime*='T']")) {
    const instant = new Date(time.dateTime);
    if (!Number.isNaN(instant.valueOf()) && instant.getTimezoneOffset() !== 0) {
      const local = instant.toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
      time.append(` (${local} your time)`);
    }
  }
}

addOwnTimes(document);
document.addEventListener("added", (event) => addOwnTimes(event.target));
