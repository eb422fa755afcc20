// Times are written in UTC; this adds the viewer's local time if it differs, to each part of a page as it comes:
// while the page is read, before it is drawn, so that nothing moves.
const WRITTEN_AS_UTC_IS = "sv"; // 2027-06-01 21:05, whatever the viewer's language

function addOwnTimes() {
  for (const time of document.querySelectorAll("time[datetime*='T']:not([data-own])")) {
    const instant = new Date(time.dateTime);
    time.dataset.own = "";
    if (Number.isNaN(instant.valueOf()) || instant.getTimezoneOffset() === 0) continue;
    const own = document.createElement("small");
    own.className = "own";
    const local = instant.toLocaleString(WRITTEN_AS_UTC_IS, { dateStyle: "short", timeStyle: "short" });
    own.textContent = `(${local} your time)`;
    time.after(" ", own);
  }
}

new MutationObserver(addOwnTimes).observe(document, { childList: true, subtree: true });
