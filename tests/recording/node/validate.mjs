// Reads an MCAP file with @mcap/core, through its index and as a stream, with every CRC checked.
// Prints what it found as JSON. Exit code 0: both ways agree with each other and with the file's
// statistics; 2: they do not, or the file cannot be read.
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open } from "node:fs/promises";

const STREAM_PIECE = 65536;

function tally() {
  const counts = new Map();
  let bytes = 0;
  return {
    add(topic, size) {
      counts.set(topic, (counts.get(topic) ?? 0) + 1);
      bytes += size;
    },
    result: () => ({ bytes, counts: Object.fromEntries([...counts].sort()) }),
  };
}

async function readIndexed(handle, decompressHandlers) {
  const readable = new FileHandleReadable(handle);
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const found = tally();
  let last = 0n;
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    if (message.logTime < last) throw new Error("messages are not in order of log time");
    last = message.logTime;
    found.add(reader.channelsById.get(message.channelId).topic, message.data.byteLength);
  }
  const attachments = {};
  for await (const a of reader.readAttachments({ validateCrcs: true })) {
    attachments[a.name] = a.data.byteLength;
  }
  const metadata = [];
  for await (const record of reader.readMetadata()) metadata.push(record.name);
  const schemas = [...reader.schemasById.values()].map((s) => s.name).sort();
  return { ...found.result(), attachments, metadata, schemas, statistics: reader.statistics };
}

async function readStream(handle, decompressHandlers) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const found = tally();
  const topics = new Map();
  const buffer = new Uint8Array(STREAM_PIECE);
  for (let position = 0; ; ) {
    const { bytesRead } = await handle.read(buffer, 0, STREAM_PIECE, position);
    if (bytesRead === 0) break;
    position += bytesRead;
    reader.append(buffer.slice(0, bytesRead));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Channel") topics.set(record.id, record.topic);
      if (record.type === "Message") found.add(topics.get(record.channelId), record.data.byteLength);
    }
  }
  if (!reader.done()) throw new Error("the stream has no end");
  return found.result();
}

function differences({ statistics, ...indexed }, streamed) {
  const total = Object.values(indexed.counts).reduce((a, b) => a + b, 0);
  const checks = {
    "counts, indexed and streamed":
      JSON.stringify(indexed.counts) === JSON.stringify(streamed.counts),
    "bytes, indexed and streamed": indexed.bytes === streamed.bytes,
    "messages and statistics": statistics.messageCount === BigInt(total),
    "attachments and statistics":
      statistics.attachmentCount === Object.keys(indexed.attachments).length,
    "metadata and statistics": statistics.metadataCount === indexed.metadata.length,
    "schemas and statistics": statistics.schemaCount === indexed.schemas.length,
  };
  return Object.keys(checks).filter((name) => !checks[name]);
}

const handle = await open(process.argv[2], "r");
try {
  const decompressHandlers = await loadDecompressHandlers();
  const indexed = await readIndexed(handle, decompressHandlers);
  const wrong = differences(indexed, await readStream(handle, decompressHandlers));
  const start = indexed.statistics.messageStartTime.toString();
  const end = indexed.statistics.messageEndTime.toString();
  console.log(JSON.stringify({ ...indexed, statistics: undefined, start, end, wrong }));
  process.exitCode = wrong.length === 0 ? 0 : 2;
} catch (error) {
  console.log(JSON.stringify({ wrong: [String(error)] }));
  process.exitCode = 2;
} finally {
  await handle.close();
}
