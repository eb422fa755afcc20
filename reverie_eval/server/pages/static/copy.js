// Buttons that copy text from elsewhere on the page.
for (const button of document.querySelectorAll("button.copy")) {
  const words = button.nextElementSibling;
  const text = document.getElementById(button.dataset.copies);
  button.hidden = false;
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text.textContent);
      words.textContent = "Copied.";
    } catch {
      // Without https there is no clipboard: select the text, so that it can be copied by keyboard.
      getSelection().selectAllChildren(text);
      words.textContent = "Selected: copy it with the keyboard.";
    }
  });
}
