// Buttons that copy text: from elsewhere on the page, or from a file of the server. The page listens
// before it has any, so each works from the moment that it is seen.
document.addEventListener("click", async ({ target: button }) => {
  if (!button.matches("button.copy")) return;
  const words = button.nextElementSibling;
  const text = document.getElementById(button.dataset.copies);
  try {
    const copied = text ? text.textContent : await fetched(button.dataset.source);
    await navigator.clipboard.writeText(copied);
    words.textContent = "Copied.";
  } catch {
    // Without https there is no clipboard: select the text, so that it can be copied by keyboard.
    if (text) getSelection().selectAllChildren(text);
    words.textContent = text ? "Selected: copy it with the keyboard." : "Could not be copied: open the link instead.";
  }
});

async function fetched(address) {
  const reply = await fetch(address);
  if (!reply.ok) throw new Error(reply.statusText);
  return reply.text();
}
