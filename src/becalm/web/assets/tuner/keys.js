// What keys do, wherever the focus is, unless it is where they mean something else.

const OWN = "input[type=number], select, [contenteditable]"; // every key is its own
const ARROWED = "input, [role=tab], [role=application]"; // arrows are

/**
 * Hear the keys of a page.
 * @param {Record<string, () => void>} actions by key; those that need Shift begin with "Shift+"
 * @param {(number: number) => void} channel told which one, from 0
 */
export function hearKeys(actions, channel) {
  addEventListener("keydown", (event) => {
    const target = /** @type {Element} */ (event.target);
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest?.(OWN)) return;
    if (event.key.startsWith("Arrow") && target.closest?.(ARROWED)) return;
    const letter = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = actions[event.shiftKey && /[a-z]/.test(letter) ? `Shift+${letter}` : letter];
    if (/^[1-9]$/.test(letter)) channel(Number(letter) - 1);
    else if (action) action();
    else return;
    event.preventDefault();
  });
}
