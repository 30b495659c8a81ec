// Reads playback files as envs/playback_files/scene.py writes them; the browser has unpacked the gzip.

const MAGIC = "VITACPB1";
const TYPES = { uint8: Uint8Array, int16: Int16Array, uint16: Uint16Array, float32: Float32Array };

/** Fetches a file; resolves to its header and its arrays by name, each with its shape. */
export async function fetchFile(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`Expected the playback at ${address}, got status ${answer.status}.`);
  return unpack(await answer.arrayBuffer());
}

export function unpack(buffer) {
  const text = new TextDecoder();
  const start = MAGIC.length + 4;
  if (text.decode(new Uint8Array(buffer, 0, MAGIC.length)) !== MAGIC) throw new Error("Expected a playback file.");
  const length = new DataView(buffer).getUint32(MAGIC.length, true);
  const header = JSON.parse(text.decode(new Uint8Array(buffer, start, length)));
  const arrays = {};
  for (const [name, described] of Object.entries(header.arrays)) {
    const size = described.shape.reduce((product, count) => product * count, 1);
    const values = new TYPES[described.type](buffer, start + length + described.at, size);
    if (described.changes) addUp(values, described.shape[0] ? size / described.shape[0] : 0);
    arrays[name] = { values, shape: described.shape };
  }
  return { header, arrays };
}

/** Turns changes along the first axis into values; typed arrays wrap around as the writer does. */
function addUp(values, row) {
  for (let index = row; index < values.length; index += 1) values[index] += values[index - row];
}
