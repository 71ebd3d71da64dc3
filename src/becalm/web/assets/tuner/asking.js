// Sends requests one at a time, for example during a drag; of the waiting requests of a kind only the newest is kept.

/** @typedef {{ do: string, channel: number, [more: string]: unknown }} QueuedRequest */

export class RequestQueue {
  /** @param {(message: object) => number | null} send */
  constructor(send) {
    this.send = send;
    /** @type {number | null} */
    this.pending = null;
    /** @type {Map<string, QueuedRequest>} */
    this.waiting = new Map();
  }

  /** Send a request after the answer to the last one; it replaces a waiting request of the same kind. @param {QueuedRequest} request */
  ask(request) {
    this.waiting.set(request.do, request);
    this.#next();
  }

  /** Send a request at once. @param {QueuedRequest} request @returns {number | null} number of the message */
  sendNow(request) {
    this.waiting.delete(request.do);
    return this.send(request);
  }

  /** Handle an answer. @param {number | null} number */
  handleAnswer(number) {
    if (number === null || this.pending === null || number < this.pending) return;
    this.pending = null;
    this.#next();
  }

  /** Drop all requests: after a disconnection they get no answer. */
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
