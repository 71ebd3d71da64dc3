// Handles the keys of a page that the focused element does not use.

const OWN = "input[type=number], select, [contenteditable]"; // elements that use all keys
const ARROWED = "input, [role=tab], [role=application]"; // elements that use the arrow keys

/**
 * Handle the keys of a page.
 * @param {Record<string, () => void>} actions by the name of the key, after "Shift+" for a letter with Shift
 * @param {(number: number) => void} channel called with the number of a channel, from 0
 */
export function handleKeys(actions, channel) {
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
