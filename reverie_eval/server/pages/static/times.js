// Times are written in UTC; this adds the viewer's local time if it differs.
const WRITTEN_AS_UTC_IS = "sv"; // 2027-06-01 21:05, whatever the viewer's language

function addOwnTimes(part) {
  for (const time of part.querySelectorAll("time[datetime*='T']")) {
    const instant = new Date(time.dateTime);
    if (Number.isNaN(instant.valueOf()) || instant.getTimezoneOffset() === 0) continue;
    const own = document.createElement("small");
    own.className = "own";
    const local = instant.toLocaleString(WRITTEN_AS_UTC_IS, { dateStyle: "short", timeStyle: "short" });
    own.textContent = `(${local} your time)`;
    time.after(" ", own);
  }
}

addOwnTimes(document);
document.addEventListener("added", (event) => addOwnTimes(event.target));
