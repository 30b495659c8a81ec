// Writes a film of one video track as a WebM file: EBML (RFC 8794) with the elements of Matroska (RFC 9559) that WebM has.

const MS_NS = 1e6;
const TRACK = 1;
const IS_KEY = 0x80;
const text = new TextEncoder();

/** `chunks` are encoded pictures in order: `{ timeMs, isKey, data }`, the first a key picture. */
export function webm({ codec, width, height, durationMs, chunks }) {
  const header = [
    element(0x4286, number(1)), // version of EBML, and what a reader must know
    element(0x42f7, number(1)),
    element(0x42f2, number(4)),
    element(0x42f3, number(8)),
    element(0x4282, text.encode("webm")),
    element(0x4287, number(4)),
    element(0x4285, number(2)),
  ];
  const name = text.encode("ViTac Arena");
  const info = element(0x1549a966, element(0x2ad7b1, number(MS_NS)), element(0x4489, float(durationMs)), element(0x4d80, name), element(0x5741, name));
  const video = element(0xe0, element(0xb0, number(width)), element(0xba, number(height)));
  const track = [element(0xd7, number(TRACK)), element(0x73c5, number(TRACK)), element(0x83, number(1)), element(0x9c, number(0))];
  const tracks = element(0x1654ae6b, element(0xae, ...track, element(0x86, text.encode(codec)), video));
  const clusters = startingWithKeys(chunks).map(cluster);
  const places = (start) => clusters.map(({ timeMs }, at) => ({ timeMs, at: start + sum(clusters.slice(0, at)) }));
  const before = info.length + tracks.length;
  const cues = index(places(before + index(places(0)).length)); // of one length wherever the clusters are
  const segment = element(0x18538067, info, tracks, cues, ...clusters.map(({ bytes }) => bytes));
  return new Blob([element(0x1a45dfa3, ...header), segment], { type: "video/webm" });
}

function startingWithKeys(chunks) {
  const groups = [];
  for (const chunk of chunks) {
    if (chunk.isKey) groups.push([]);
    groups.at(-1).push(chunk);
  }
  return groups;
}

function cluster(chunks) {
  const [{ timeMs }] = chunks;
  const blocks = chunks.map((chunk) => {
    const after = Math.round(chunk.timeMs) - Math.round(timeMs);
    return element(0xa3, [0x80 | TRACK, after >> 8, after & 0xff, chunk.isKey ? IS_KEY : 0], chunk.data);
  });
  return { timeMs, bytes: element(0x1f43b675, element(0xe7, number(timeMs)), ...blocks) };
}

/** Where clusters begin, by which players find a time. */
function index(places) {
  const points = places.map(({ timeMs, at }) =>
    element(0xbb, element(0xb3, number(timeMs)), element(0xb7, element(0xf7, number(TRACK)), element(0xf1, number(at)))),
  );
  return element(0x1c53bb6b, ...points);
}

function sum(clusters) {
  return clusters.reduce((length, { bytes }) => length + bytes.length, 0);
}

/** An element: its id, its length in eight bytes, and its parts. */
function element(id, ...parts) {
  const length = parts.reduce((total, part) => total + part.length, 0);
  const ids = id.toString(16).match(/../g).map((byte) => parseInt(byte, 16));
  const made = new Uint8Array(ids.length + 8 + length);
  made.set(ids);
  new DataView(made.buffer).setBigUint64(ids.length, (1n << 56n) | BigInt(length));
  let at = ids.length + 8;
  for (const part of parts) {
    made.set(part, at);
    at += part.length;
  }
  return made;
}

function number(value) {
  return eightBytes((view) => view.setBigUint64(0, BigInt(Math.round(value))));
}

function float(value) {
  return eightBytes((view) => view.setFloat64(0, value));
}

function eightBytes(write) {
  const bytes = new Uint8Array(8);
  write(new DataView(bytes.buffer));
  return bytes;
}
