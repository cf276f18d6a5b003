"""Reads a recording with Python's mcap package and an export with PyArrow; any difference is an error.

    check.py RECORDING.mcap EXPORT/numbers
"""

import collections
import csv
import importlib
import pathlib
import sys

import pyarrow.parquet
from google.protobuf import descriptor_pb2
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

# A first picture of either kind begins so.
MAGIC = {"jpeg": b"\xff\xd8\xff", "png": b"\x89PNG"}


def messages(path):
    """Every message decoded, twice: by the index at the end, and from front to back."""
    counts = collections.Counter()
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for _, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            if channel.topic.endswith("/image"):
                assert bytes(message.data).startswith(MAGIC[message.format]), channel.topic
        file.seek(0)
        straight = sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages())
        attachments = [a.name for a in reader.iter_attachments()]
    total = sum(counts.values())
    assert total == straight == summary.statistics.message_count, (total, straight)
    assert "settings.toml" in attachments, attachments
    return counts, summary.schemas.values()


def schemas(schemas):
    """Our descriptors of Foxglove's messages have the names, numbers and types of Foxglove's own package."""
    compared = 0
    for schema in schemas:
        if not schema.name.startswith("foxglove."):
            continue
        ours = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file[-1].message_type[0]
        name = schema.name.split(".")[-1]
        module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
        theirs = getattr(module, name).DESCRIPTOR
        for field in theirs.fields:
            mine = [f for f in ours.field if f.number == field.number]
            assert mine and mine[0].name == field.name and mine[0].type == field.type, field.full_name
            compared += 1
    assert compared > 20, compared
    return compared


def tables(folder):
    """Every cell of every Parquet file is that of the CSV file beside it."""
    cells = 0
    for path in sorted(pathlib.Path(folder).glob("*.parquet")):
        table = pyarrow.parquet.read_table(path).to_pylist()
        with open(path.with_suffix(".csv"), newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(table), path
        for mine, row in zip(table, rows):
            for name, text in row.items():
                value = mine[name]
                same = text == "" if value is None else text == value if isinstance(value, str) else float(text) == value
                assert same, (path, name, text, value)
                cells += 1
    assert cells > 0
    return cells


def main():
    counts, all_schemas = messages(sys.argv[1])
    fields = schemas(all_schemas)
    cells = tables(sys.argv[2])
    print(f"mcap: {sum(counts.values())} messages of {len(counts)} channels; {fields} fields as Foxglove's; pyarrow: {cells} cells")


main()
