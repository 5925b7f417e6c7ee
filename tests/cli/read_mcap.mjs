// Reads recordings with @mcap/core, by index and as a stream, and prints what it found, or what is wrong, as JSON.
// Usage: node read_mcap.mjs DIRECTORY_WITH_NODE_MODULES FILE...
import { open, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const require = createRequire(join(resolve(process.argv[2]), "read_mcap.cjs"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { crc32 } = require("@foxglove/crc");
const fzstd = require("fzstd");

const decompressHandlers = { zstd: (data, size) => fzstd.decompress(data, new Uint8Array(Number(size))) };

async function byIndex(path) {
  const file = await open(path);
  try {
    const readable = {
      size: async () => BigInt((await file.stat()).size),
      read: async (offset, length) => {
        const data = new Uint8Array(Number(length));
        const { bytesRead } = await file.read(data, 0, data.length, Number(offset));
        if (bytesRead !== data.length) throw new Error("file ends too early");
        return data;
      },
    };
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    const found = { topics: {}, attachments: [], metadata: {}, chunks: reader.chunkIndexes.length };
    let last = 0n;
    for await (const message of reader.readMessages({ validateCrcs: true })) {
      if (message.logTime < last) throw new Error("messages out of order");
      last = message.logTime;
      const { topic } = reader.channelsById.get(message.channelId);
      found.topics[topic] = (found.topics[topic] ?? 0) + 1;
    }
    for await (const one of reader.readAttachments({ validateCrcs: true })) found.attachments.push(one.name);
    for await (const one of reader.readMetadata()) found.metadata[one.name] = Object.fromEntries(one.metadata);
    if (!reader.dataSectionCrc || !reader.footer.summaryCrc) throw new Error("without checksums");
    const data = await readFile(path);
    if (crc32(data.subarray(0, Number(reader.dataEndOffset))) !== reader.dataSectionCrc) {
      throw new Error("Incorrect data section CRC");
    }
    found.counted = Number(reader.statistics.messageCount);
    return found;
  } finally {
    await file.close();
  }
}

async function streamed(path) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true, includeChunks: true });
  reader.append(await readFile(path));
  let messages = 0;
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Message") messages++;
    if (record.type === "Chunk" && !record.uncompressedCrc) throw new Error("chunk without a checksum");
  }
  if (!reader.done()) throw new Error("no end");
  return messages;
}

const results = [];
for (const path of process.argv.slice(3)) {
  try {
    results.push({ ...(await byIndex(path)), streamed: await streamed(path) });
  } catch (error) {
    results.push({ error: String(error) });
  }
}
console.log(JSON.stringify(results));
