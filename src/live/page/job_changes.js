// What was changed in a job: the keys that are sent. The service merges a table; the rows of a list keep their identity by `row`, their
// index in the file that was read, and those that are not listed are removed. Null removes a key.

const isTable = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const isRows = (value) => Array.isArray(value) && value.every(isTable);
const same = (one, other) => JSON.stringify(one ?? null) === JSON.stringify(other ?? null);

/** The keys of a table that differ from those that were read. @param {any} read @param {any} now @returns {any} */
export function changedKeys(read, now) {
  const keys = {};
  for (const [key, value] of Object.entries(now)) {
    const before = read?.[key];
    if (isRows(value)) {
      const rows = changedRows(before ?? [], value);
      if (rows) keys[key] = rows;
    } else if (isTable(value)) {
      const inner = changedKeys(before, value);
      if (Object.keys(inner).length) keys[key] = inner;
    } else if (!same(value, before)) {
      keys[key] = value;
    }
  }
  return keys;
}

/** All rows that shall remain, each with what differs; null if the list is as it was. @param {any[]} read @param {any[]} rows */
function changedRows(read, rows) {
  const changed = rows.map(({ row, ...now }) => (row === undefined ? changedKeys({}, now) : { row, ...changedKeys(read[row], now) }));
  const isSame = rows.length === read.length && changed.every((one, at) => one.row === at && Object.keys(one).length === 1);
  return isSame ? null : changed;
}

/** The smallest number that no base ball has. @param {number[]} ids */
export function freeId(ids) {
  let id = 1;
  while (ids.includes(id)) id++;
  return id;
}
