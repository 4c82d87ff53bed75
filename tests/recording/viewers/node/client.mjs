// Foxglove's own client: subscribes to every channel of URL as a page of ORIGIN, prints what comes.
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const [url, origin] = process.argv.slice(2);
const socket = new WebSocket(url, ["foxglove.websocket.v1"], { origin });
const client = new protocol.FoxgloveClient({ ws: socket });
const found = { channels: {}, bytes: {}, status: [] };
const topics = new Map();

function end(error) {
  console.log(JSON.stringify({ ...found, error }));
  process.exit(error ? 1 : 0);
}
client.on("error", (error) => end(error.message));
client.on("serverInfo", (info) => Object.assign(found, { name: info.name }));
client.on("status", (status) => found.status.push(status.message));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    found.channels[channel.topic] = channel.schemaName;
    topics.set(client.subscribe(channel.id), channel.topic);
  }
});
client.on("message", ({ subscriptionId, data }) => {
  const topic = topics.get(subscriptionId);
  found.bytes[topic] = data.byteLength;
  if (Object.keys(found.bytes).length === topics.size) end();
});
setTimeout(() => end("not all channels came"), 60_000);
