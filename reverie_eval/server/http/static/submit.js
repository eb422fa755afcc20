// Sends the form in the background: to check the file as soon as one is chosen, and to score it on
// request. The outcome is copied from the server's page into this one, so no input is lost.
const form = document.querySelector("form.upload");
const { file } = form.elements;
const drop = form.querySelector(".drop");
const state = form.querySelector(".state");
const sent = form.querySelector(".sent");
const buttons = form.querySelectorAll("button[name=what]");
const limit = Number(form.dataset.mebibytes) * 2 ** 20;
const [checkButton, scoreButton] = buttons;
const cancelButton = form.querySelector(".cancel");

let underWay = null;

function say(words) {
  state.textContent = words;
}

function show(found) {
  form.querySelector("#outcome").replaceChildren(...found);
}

function fault(words) {
  const box = document.createElement("div");
  box.className = "fault";
  box.setAttribute("role", "alert");
  const line = document.createElement("p");
  line.textContent = words;
  box.append(line);
  return box;
}

function rest() {
  underWay = null;
  sent.hidden = true;
  cancelButton.hidden = true;
  form.removeAttribute("aria-busy");
  for (const button of buttons) button.disabled = false;
}

function take(reply, what) {
  const { pathname } = new URL(reply.responseURL);
  if (pathname === new URL("sign-in", location).pathname) {
    rest();
    say("");
    const box = fault("You are signed out, and nothing was scored. Everything here is kept: sign in in another window, then come back and send it again. ");
    const link = document.createElement("a");
    Object.assign(link, { href: "sign-in", target: "_blank", textContent: "Sign in" });
    box.firstElementChild.append(link);
    show([box]);
    link.focus();
    return;
  }
  if (pathname !== location.pathname) {
    say("Scored.");
    location.assign(reply.responseURL);
    return;
  }
  rest();
  const page = reply.response;
  const { csrf_token: token } = page?.querySelector("form.upload")?.elements ?? {};
  if (token && token.value !== form.elements.csrf_token.value) { // somebody has signed in again since: this was refused
    form.elements.csrf_token.value = token.value;
    send(what);
    return;
  }
  const outcome = page?.querySelector("#outcome");
  const other = page?.querySelectorAll("main .fault") ?? [];
  show(outcome ? outcome.childNodes : other.length ? other : [fault("The server's reply could not be read. Try again.")]);
  say("");
  if (what === "check") checkButton.textContent = "Check again";
  // A file that cannot be scored needs no second try; choosing another one enables the button again.
  scoreButton.disabled = form.querySelector("#outcome .problems") !== null;
  for (const field of form.querySelectorAll(".field")) renew(field, page);
  form.querySelector("#outcome").scrollIntoView({ block: "nearest" });
  if (what === "score") (form.querySelector("[aria-invalid=true]") ?? form.querySelector("#outcome")).focus();
}

// Copies the server's message about a field.
function renew(field, page) {
  const input = field.querySelector("[id]:is(input, select, textarea)");
  const now = page?.getElementById(input.id);
  if (!now) return;
  field.querySelector(".wrong")?.remove();
  const wrong = now.parentElement.querySelector(".wrong");
  if (wrong) field.append(wrong);
  for (const name of ["aria-invalid", "aria-describedby"]) {
    if (now.hasAttribute(name)) input.setAttribute(name, now.getAttribute(name));
    else input.removeAttribute(name);
  }
}

function send(what) {
  underWay?.abort();
  show([]);
  if (file.files[0]?.size > limit) {
    rest();
    say("");
    show([fault(`${file.files[0].name} is larger than ${form.dataset.mebibytes} MiB; nothing was sent. Gzip it, or remove what is not scored, and choose it again.`)]);
    return;
  }
  const content = new FormData(form);
  content.set("what", what);
  const request = new XMLHttpRequest();
  underWay = request;
  request.open("POST", form.action);
  request.responseType = "document";
  request.upload.addEventListener("progress", (event) => {
    if (event.lengthComputable) sent.value = event.loaded / event.total;
  });
  request.upload.addEventListener("load", () => {
    cancelButton.hidden = true; // from now on, it may be scored
    sent.removeAttribute("value");
    say(what === "score" ? "Scoring ..." : "Checking ...");
  });
  request.addEventListener("load", () => take(request, what));
  request.addEventListener("error", () => {
    rest();
    say("");
    show([fault("The connection failed, or the file changed during the upload. Choose the file again; it will not be counted twice.")]);
  });
  form.setAttribute("aria-busy", "true");
  for (const button of buttons) button.disabled = true;
  sent.value = 0;
  sent.hidden = false;
  cancelButton.hidden = false;
  say(`Sending ${file.files[0]?.name ?? ""} ...`);
  request.send(content);
}

cancelButton.addEventListener("click", () => {
  underWay?.abort();
  rest();
  say("Cancelled. Nothing was scored.");
  file.focus();
});

form.addEventListener("click", ({ target }) => {
  const { split } = target.dataset;
  if (!split) return;
  form.querySelector(`[name=split][value="${split}"]`).checked = true;
  check();
});

function check() {
  if (file.files.length) send("check");
  else show([]);
}

file.addEventListener("change", check);
for (const choice of form.querySelectorAll("[name=split]")) choice.addEventListener("change", check);

form.addEventListener("submit", (event) => {
  event.preventDefault();
  if (underWay) return;
  const what = event.submitter?.value ?? "check";
  if (what === "check" && !file.files.length) file.reportValidity();
  else send(what);
});

for (const kind of ["dragenter", "dragover"]) {
  addEventListener(kind, (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault(); // outside the box, the browser would open the file and leave the page
    drop.classList.add("over");
  });
}
addEventListener("dragleave", (event) => {
  if (!event.relatedTarget) drop.classList.remove("over");
});
function choose(chosen) {
  const one = new DataTransfer();
  one.items.add(chosen);
  file.files = one.files;
  check();
}

addEventListener("drop", (event) => {
  if (!event.dataTransfer?.files.length) return;
  event.preventDefault();
  drop.classList.remove("over");
  choose(event.dataTransfer.files[0]);
});

rest(); // also when the browser restores the page, or its buttons as they were left
addEventListener("pageshow", ({ persisted }) => {
  if (persisted) rest();
});

// A person who comes from /play brings the walks that this browser keeps.
const asked = new URLSearchParams(location.search);
const walks = asked.get("human") === "true" ? walksFile(asked.get("split")) : null;
if (walks) choose(walks);
else if (file.files.length) check(); // chosen before this script came
