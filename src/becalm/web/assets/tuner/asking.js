// What is asked while something is dragged: one question at a time, and only the newest waits.

/** @typedef {{ do: string, channel: number, [more: string]: unknown }} Question */

export class Asking {
  /** @param {(message: object) => number | null} send */
  constructor(send) {
    this.send = send;
    /** @type {number | null} */
    this.asked = null;
    /** @type {Map<string, Question>} */
    this.waiting = new Map();
  }

  /** Ask once the last question is answered; what waits of the same kind is forgotten. @param {Question} question */
  ask(question) {
    this.waiting.set(question.do, question);
    this.#next();
  }

  /** Ask at once what must not be lost. @param {Question} question @returns {number | null} which message it is */
  tell(question) {
    this.waiting.delete(question.do);
    return this.send(question);
  }

  /** An answer has come. @param {number | null} number */
  heard(number) {
    if (number === null || this.asked === null || number < this.asked) return;
    this.asked = null;
    this.#next();
  }

  /** Nobody will answer what was asked. */
  forget() {
    this.asked = null;
    this.waiting.clear();
  }

  #next() {
    const [first] = this.waiting.values();
    if (!first || this.asked !== null) return;
    this.waiting.delete(first.do);
    this.asked = this.send(first);
  }
}
