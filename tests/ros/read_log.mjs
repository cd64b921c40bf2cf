// Reads a log as Foxglove does, with @mcap/core: through its index, checksums compared, schemas parsed, messages decoded.
//
//     node read_log.mjs RUN.mcap > CONTENT.json
import { createHash } from "node:crypto";
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
});

const sha256 = (data) => createHash("sha256").update(data).digest("hex");
const coordinates = (points) => {
  const numbers = new Float64Array(3 * points.length);
  points.forEach((point, i) => numbers.set([point.x, point.y, point.z], 3 * i));
  return new Uint8Array(numbers.buffer);
};
const essence = {
  "std_msgs/msg/String": (message) => sha256(message.data),
  "shape_msgs/msg/Mesh": (message) => sha256(coordinates(message.vertices)),
  "visualization_msgs/msg/Marker": (message) => sha256(coordinates(message.points)),
  "diagnostic_msgs/msg/DiagnosticArray": (message) => message.status[0].name,
};

const decoders = new Map();
const topics = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  if (!decoders.has(schema.id)) {
    decoders.set(schema.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  const decoded = decoders.get(schema.id).readMessage(message.data);
  const topic = (topics[channel.topic] ??= { qos: channel.metadata.get("offered_qos_profiles"), messages: [] });
  topic.messages.push([message.logTime.toString(), sha256(message.data), essence[schema.name](decoded)]);
}
console.log(JSON.stringify({ profile: reader.header.profile, topics }));
await file.close();
