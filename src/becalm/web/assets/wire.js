// The wire to becalm: JSON goes up, JSON and frames come down; what breaks is tied again.

import { decode } from "./frames.js";

/**
 * @typedef {{ up: boolean, again_s: number, reason: string, hint: string }} Link whether the wire holds; else when it is
 * tried again, why it was refused, if it was, and what may help where it was tried often
 * @typedef {object} Ears
 * @property {(message: any) => void} text
 * @property {(frame: import("./frames.js").Frame) => void} frame
 * @property {(link: Link) => void} link
 */

const FIRST_S = 0.5;
const LONGEST_S = 8;
const OFTEN = 4;
const HINT = " If it was started anew, open the address that it printed."; // where another token is

/**
 * Tie the wire of this page, and keep it tied.
 * @param {Ears} ears
 * @returns {(message: object) => number | null} sends a message and returns its number; null while nobody hears
 */
export function connect(ears) {
  /** @type {WebSocket} */
  let socket;
  let number = 0;
  let tries = 0;

  function tie() {
    socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/wire`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      ears.link({ up: true, again_s: 0, reason: "", hint: "" });
    });
    socket.addEventListener("message", ({ data }) => {
      tries = 0; // a door that is shut at once is not open
      if (typeof data === "string") ears.text(JSON.parse(data));
      else ears.frame(decode(data));
    });
    socket.addEventListener("close", ({ reason }) => {
      const again_s = Math.min(LONGEST_S, FIRST_S * 2 ** tries);
      tries += 1;
      ears.link({ up: false, again_s, reason, hint: tries < OFTEN ? "" : HINT });
      setTimeout(tie, 1000 * again_s);
    });
  }

  tie();
  return (message) => {
    if (socket.readyState !== WebSocket.OPEN) return null;
    number += 1;
    socket.send(JSON.stringify({ ...message, number }));
    return number;
  };
}
