// Names for what viser's page leaves without one, so that screen readers can say what it is.
const nameOf = (element) => {
  if (element.matches(".mantine-CloseButton-root")) return "Close this note";
  if (element.matches("button")) return "Settings of the view";
  let around = element; // a slider and its number stand beside their label
  while (around && !/[a-z]/i.test(around.textContent)) around = around.parentElement;
  return around ? around.textContent.replace(/[\d.]+/g, " ").trim().slice(0, 60) : "Value";
};
new MutationObserver(() => {
  for (const element of document.querySelectorAll("button, [role=slider], input")) {
    const named = element.getAttribute("aria-label") || element.textContent.trim();
    if (!named && !element.labels?.length) element.setAttribute("aria-label", nameOf(element));
  }
}).observe(document, { childList: true, subtree: true });
