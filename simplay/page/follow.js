// A list of lines whose end stays in view, unless somebody has scrolled up.

// px from the end that still are the end
const NEAR = 30;

// What is to be called when a line was added; a list that becomes smaller follows by itself.
export function follow(list) {
  let isAtEnd = true;
  const end = () => { if (isAtEnd) list.scrollTop = list.scrollHeight; };
  list.addEventListener("scroll", () => {
    isAtEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - NEAR;
  });
  new ResizeObserver(end).observe(list);
  return end;
}
