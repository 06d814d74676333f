// Numbers as people write them.

const whole = new Intl.NumberFormat("en-US");

export const count = (value) => whole.format(value);

/** A few digits: 0, 0.0312, 4.71, 20370, 3.1e-7. */
export function short(value, digits = 3) {
  if (value === null || value === undefined) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) {
    const [mantissa, exponent] = value.toExponential(Math.max(digits - 2, 1)).split("e");
    return `${mantissa}e${Number(exponent)}`.replace(/-/g, "−");
  }
  if (size >= 1e4) return whole.format(Math.round(value)).replace("-", "−");
  const places = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(places).replace("-", "−");
}

/** A number on an axis, without zeros that say nothing. */
export function tick(value) {
  const size = Math.abs(value);
  if (value !== 0 && (size >= 1e6 || size < 1e-3)) return short(value);
  return new Intl.NumberFormat("en-US", { maximumSignificantDigits: 6 }).format(value);
}

/** How far an eigenvalue is off: at most (a bound) or about (an estimate). */
export function off(spectrum, mode) {
  const size = spectrum.errors?.[mode] ?? null;
  return size === null ? "" : `${spectrum.bounded[mode] ? "≤" : "≈"} ${short(size, 1)}`;
}

/** A relative change in per cent, with its sign. */
export function percent(value) {
  if (value === null || value === undefined) return "–";
  const text = short(100 * value, 2);
  return `${value > 0 ? "+" : ""}${text} %`;
}

/** The error of a mode; 0 where it is nothing but rounding. */
export function error(value) {
  return short(value !== null && value < 1e-15 ? 0 : value, 2);
}

/** The relative change of an eigenvalue in per cent; "equal" where it is nothing but rounding. */
export function change({ exact, predicted, comparison }, mode) {
  const relative = comparison.eigenvalue_error[mode];
  const bound = (exact.residuals?.[mode] ?? 0) + (predicted.residuals?.[mode] ?? 0);
  const size = Math.abs(relative ?? 1);
  const rounding = size <= 1e-14 || (size <= 1e-9 && size * Math.abs(exact.eigenvalues[mode]) <= bound);
  return rounding ? "equal" : percent(relative);
}
