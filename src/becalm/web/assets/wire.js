// The WebSocket to becalm: sends JSON, receives JSON and binary frames, and reconnects after a failure.

import { decode } from "./frames.js";

/**
 * @typedef {{ up: boolean, again_s: number, reason: string, hint: string }} Link whether the connection is open; if it is
 * not: time to the next attempt, reason for a refusal, advice after several attempts
 * @typedef {object} Handlers functions that are called with messages, frames, and changes of the connection
 * @property {(message: any) => void} text
 * @property {(frame: import("./frames.js").Frame) => void} frame
 * @property {(link: Link) => void} link
 */

const FIRST_S = 0.5;
const LONGEST_S = 8;
const OFTEN = 4; // number of failed attempts after which advice is shown
const HINT = " If becalm was restarted, open the address that it printed."; // a new address has a new token

/**
 * Connect this page to becalm, and reconnect after failures.
 * @param {Handlers} handlers
 * @returns {(message: object) => number | null} sends a message and returns its number; null without a connection
 */
export function connect(handlers) {
  /** @type {WebSocket} */
  let socket;
  let number = 0;
  let tries = 0;

  function open() {
    socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/wire`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      handlers.link({ up: true, again_s: 0, reason: "", hint: "" });
    });
    socket.addEventListener("message", ({ data }) => {
      tries = 0; // only a message shows that the connection works
      if (typeof data === "string") handlers.text(JSON.parse(data));
      else handlers.frame(decode(data));
    });
    socket.addEventListener("close", ({ reason }) => {
      const again_s = Math.min(LONGEST_S, FIRST_S * 2 ** tries);
      tries += 1;
      handlers.link({ up: false, again_s, reason, hint: tries < OFTEN ? "" : HINT });
      setTimeout(open, 1000 * again_s);
    });
  }

  open();
  return (message) => {
    if (socket.readyState !== WebSocket.OPEN) return null;
    number += 1;
    socket.send(JSON.stringify({ ...message, number }));
    return number;
  };
}
