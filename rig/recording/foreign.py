"""Foreign content of a recording: channels, attachments and metadata of other programs, kept as they are."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema

from rig.recording.chunk import Chunk

RIG_NAME, PROVENANCE = "rig.json", "provenance"

OWN = {Attachment: RIG_NAME, Metadata: PROVENANCE}
_NONE = np.zeros((0, 0))


@dataclass(frozen=True)
class Foreign:
    """Records in the order in which they were found."""

    front: list[Attachment | Metadata] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)

    def noting(self, records: Iterable[McapRecord]) -> Iterator[McapRecord]:
        """Passes the records of a file on, and keeps those that are not the recording's own."""
        for record in records:
            if isinstance(record, Attachment | Metadata):
                if record.name != OWN[type(record)] and record not in self.front:
                    self.front.append(record)
            elif isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel) and not _is_own(record):
                self.channels.setdefault(record.id, record)
            elif isinstance(record, Message) and record.channel_id in self.channels:
                self.messages.append(replace(record, data=bytes(record.data)))
            yield record

    def numbered(self, schemas: int, channels: int) -> "Foreign":
        """Content with ids behind this many others; a schema that no channel uses or none describes is left out."""
        used = sorted({c.schema_id for c in self.channels.values()} & set(self.schemas))
        schema_ids = {old: schemas + k for k, old in enumerate(used, start=1)}
        ids = {old: channels + k for k, old in enumerate(self.channels, start=1)}
        return Foreign(
            self.front,
            {schema_ids[old]: replace(self.schemas[old], id=schema_ids[old]) for old in used},
            {ids[o]: replace(c, id=ids[o], schema_id=schema_ids.get(c.schema_id, 0)) for o, c in self.channels.items()},
            [replace(message, channel_id=ids[message.channel_id]) for message in self.messages],
        )


def put(message: Message, chunk: Chunk) -> None:
    chunk.add(message.channel_id, message.log_time, message.sequence, bytes(message.data), _NONE, message.publish_time)


def _is_own(channel: Channel) -> bool:
    parts = channel.topic.split("/")
    return len(parts) >= 4 and parts[1] == "rig" and (parts[3:] == ["block"] or parts[3] == "preview")
