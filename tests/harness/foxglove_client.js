// Foxglove's own client (npm: @foxglove/ws-protocol) on a station: `node foxglove_client.js ADDRESS`, a JSON of what came.
// NODE_PATH says where the packages are.

const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { WebSocket } = require("ws");

const socket = new WebSocket(process.argv[2], [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
const client = new FoxgloveClient({ ws: socket });
const channels = new Map(), topics = new Map(), found = { messages: {} };

function end(status) {
  console.log(JSON.stringify(found));
  process.exit(status);
}
socket.on("unexpected-response", (_request, response) => {
  found.refused = response.statusCode;
  end(0);
});
client.on("error", (error) => {
  found.error = String(error);
  end(1);
});
client.on("serverInfo", (info) => {
  found.info = info;
});
client.on("advertise", (advertised) => {
  found.channels = advertised;
  for (const channel of advertised) {
    channels.set(client.subscribe(channel.id), channel);
  }
  client.getParameters([], "all");
});
client.on("parameterValues", ({ id, parameters }) => {
  found.parameters = parameters;
  found.request = id;
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const channel = channels.get(subscriptionId);
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  const text = channel.encoding === "json" ? JSON.parse(bytes.toString()) : bytes.toString("base64");
  topics.set(channel.topic, (topics.get(channel.topic) ?? 0) + 1);
  found.messages[channel.topic] = { timestamp: String(timestamp), count: topics.get(channel.topic), message: text };
  // The truth is there only where there is one, and the rows come ten times as often as the pictures.
  const wanted = found.channels.filter((each) => each.topic !== "/tip/true");
  if (found.parameters && wanted.every((each) => topics.has(each.topic)) && topics.get("/scene") >= 5) {
    end(0);
  }
});
setTimeout(() => end(1), 60000);
