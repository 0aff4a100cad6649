// Numbers in text, read from bytes: a string for each of nine million of them would take seconds.

const ZERO = 48;
const NINE = 57;
const PLUS = 43;
const MINUS = 45;
const POINT = 46;
const COMMA = 44;

const POWERS = Float64Array.from({ length: 23 }, (_, k) => 10 ** k);

/** The number in bytes[from, to), or NaN where there is none. */
export function numberIn(bytes: Uint8Array, from: number, to: number, comma = false): number {
  let at = from;
  let sign = 1;
  if (bytes[at] === MINUS || bytes[at] === PLUS) {
    if (bytes[at] === MINUS) sign = -1;
    at++;
  }
  let mantissa = 0;
  let digits = 0;
  let exponent = 0;
  let seen = 0;
  let fraction = false;
  for (; at < to; at++) {
    const byte = bytes[at] as number;
    if (byte >= ZERO && byte <= NINE) {
      seen++;
      if (digits < 17) {
        mantissa = mantissa * 10 + (byte - ZERO);
        if (mantissa > 0) digits++;
        if (fraction) exponent--;
      } else if (!fraction) exponent++;
    } else if (!fraction && (byte === POINT || (comma && byte === COMMA))) fraction = true;
    else break;
  }
  if (seen === 0) return NaN;
  if (at < to) {
    const letter = (bytes[at] as number) | 32;
    if (letter !== 101 && letter !== 100) return NaN; // e or d
    const written = wholeIn(bytes, at + 1, to);
    if (Number.isNaN(written)) return NaN;
    exponent += written;
  }
  return sign * scaled(mantissa, exponent);
}

function wholeIn(bytes: Uint8Array, from: number, to: number): number {
  let at = from;
  let sign = 1;
  if (bytes[at] === MINUS || bytes[at] === PLUS) {
    if (bytes[at] === MINUS) sign = -1;
    at++;
  }
  if (at >= to) return NaN;
  let value = 0;
  for (; at < to; at++) {
    const digit = (bytes[at] as number) - ZERO;
    if (digit < 0 || digit > 9) return NaN;
    value = value * 10 + digit;
  }
  return sign * value;
}

function scaled(mantissa: number, exponent: number): number {
  if (exponent === 0) return mantissa;
  if (exponent < 0 && exponent >= -22) return mantissa / (POWERS[-exponent] as number);
  if (exponent > 0 && exponent <= 22) return mantissa * (POWERS[exponent] as number);
  return mantissa * 10 ** exponent;
}
