// A button that copies what is written elsewhere on the page.
for (const button of document.querySelectorAll("button.copy")) {
  const words = document.querySelector(".copied");
  const text = document.getElementById(button.dataset.copies);
  button.hidden = false;
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text.textContent);
      words.textContent = "Copied.";
    } catch {
      // Without https there is no clipboard: it is marked, for the keyboard to copy.
      getSelection().selectAllChildren(text);
      words.textContent = "Marked: copy it with the keyboard.";
    }
  });
}
