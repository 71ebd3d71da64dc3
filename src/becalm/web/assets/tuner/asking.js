// Sends requests during a drag: one at a time, of which only the newest is queued.

/** @typedef {{ do: string, channel: number, [more: string]: unknown }} Question */

export class Asking {
  /** @param {(message: object) => number | null} send */
  constructor(send) {
    this.send = send;
    /** @type {number | null} */
    this.pending = null;
    /** @type {Map<string, Question>} */
    this.waiting = new Map();
  }

  /** Send a request after the answer to the last one; it replaces a queued one of the same kind. @param {Question} question */
  ask(question) {
    this.waiting.set(question.do, question);
    this.#next();
  }

  /** Send a request at once. @param {Question} question @returns {number | null} number of the message */
  sendNow(question) {
    this.waiting.delete(question.do);
    return this.send(question);
  }

  /** Handle an answer. @param {number | null} number */
  heard(number) {
    if (number === null || this.pending === null || number < this.pending) return;
    this.pending = null;
    this.#next();
  }

  /** Drop all requests, which get no answer. */
  forget() {
    this.pending = null;
    this.waiting.clear();
  }

  #next() {
    const [first] = this.waiting.values();
    if (!first || this.pending !== null) return;
    this.waiting.delete(first.do);
    this.pending = this.send(first);
  }
}
