// The steps of a tour, as a project's document has them.

// *What is pressed* and `what is typed`, see playground.md
const MARKED = /(\*\*.+?\*\*|\*[^*]+\*|`[^`]+`)/;

function words(text) {
  const parts = text.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").split(MARKED);
  return parts.filter(Boolean).map((part) => {
    const [, stars, inner] = /^(\*\*|\*|`)(.+)\1$/.exec(part) || [];
    if (!inner) return part;
    const name = { "**": "strong", "*": "em", "`": "code" }[stars];
    return Object.assign(document.createElement(name), { textContent: inner });
  });
}

// `steps`: [title, text] each; without any there is none.
export function showTour(section, list, steps) {
  section.hidden = !steps.length;
  list.replaceChildren(...steps.map(([title, text]) => {
    const step = document.createElement("li");
    step.append(Object.assign(document.createElement("strong"), { textContent: `${title}. ` }), ...words(text));
    return step;
  }));
}
