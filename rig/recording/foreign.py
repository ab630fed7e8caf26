"""Foreign content of a recording: channels, attachments and metadata of other programs, kept as they are."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from rig.recording.container_writer import Chunk

RIG_NAME, PROVENANCE = "rig.json", "provenance"

OWN_NAME_BY_TYPE = {Attachment: RIG_NAME, Metadata: PROVENANCE}
_NO_VALUES = np.zeros((0, 0))


@dataclass(frozen=True)
class ForeignRecords:
    """Records of other programs, in the order of the file."""

    front_records: list[Attachment | Metadata] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)

    def collect_while_reading(self, records: Iterable[McapRecord]) -> Iterator[McapRecord]:
        """Pass on the records of a file and keep those that are not the recording's own."""
        for record in records:
            if isinstance(record, Attachment | Metadata):
                if record.name != OWN_NAME_BY_TYPE[type(record)] and record not in self.front_records:
                    self.front_records.append(record)
            elif isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel) and not _is_rig_channel(record):
                self.channels.setdefault(record.id, record)
            elif isinstance(record, Message) and record.channel_id in self.channels:
                self.messages.append(replace(record, data=bytes(record.data)))
            yield record

    def renumbered(self, schema_count: int, channel_count: int) -> "ForeignRecords":
        """Content renumbered behind `schema_count` and `channel_count` other ids; unused schemas are left out."""
        used_schema_ids = sorted({channel.schema_id for channel in self.channels.values()} & set(self.schemas))
        schema_ids = {old_id: schema_count + number for number, old_id in enumerate(used_schema_ids, start=1)}
        channel_ids = {old_id: channel_count + number for number, old_id in enumerate(self.channels, start=1)}
        return ForeignRecords(
            self.front_records,
            {schema_ids[old_id]: replace(self.schemas[old_id], id=schema_ids[old_id]) for old_id in used_schema_ids},
            {
                channel_ids[o]: replace(channel, id=channel_ids[o], schema_id=schema_ids.get(channel.schema_id, 0))
                for o, channel in self.channels.items()
            },
            [replace(message, channel_id=channel_ids[message.channel_id]) for message in self.messages],
        )


def copy_foreign_message(message: Message, chunk: Chunk) -> None:
    chunk.add(
        message.channel_id, message.log_time, message.sequence, bytes(message.data), _NO_VALUES, message.publish_time
    )


def _is_rig_channel(channel: Channel) -> bool:
    topic_parts = channel.topic.split("/")
    return (
        len(topic_parts) >= 4
        and topic_parts[1] == "rig"
        and (topic_parts[3:] == ["block"] or topic_parts[3] == "preview")
    )
