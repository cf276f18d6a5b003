//! Parquet files of plain columns: one row group after the other, PLAIN encoding, no compression.
//!
//! Source: the Apache Parquet format (parquet.thrift, version 2.6), and Thrift's compact protocol. Only what a table of numbers and words needs: flat
//! columns, required or optional. Any reader of Parquet reads this; the library of the Arrow project would cost 145 CPU seconds to build.

use std::io::{self, Write};

use crate::table::{Cell, Column, Kind};

/// Bytes in memory after which a row group is written: some ten thousand rows of numbers. One row may come on top.
const GROUP_BYTES: usize = 8 << 20;

/// The first and the last bytes of a file.
const MAGIC: &[u8] = b"PAR1";

/// A Parquet file while it is written. [`ParquetWriter::finish`] ends it; a file without its end cannot be read.
pub struct ParquetWriter<W> {
    out: W,
    columns: &'static [Column],
    rows: Vec<Vec<Option<Cell>>>,
    /// What the rows take in memory.
    bytes: usize,
    groups: Vec<Group>,
    position: i64,
}

struct Group {
    rows: i64,
    chunks: Vec<Chunk>,
}

struct Chunk {
    offset: i64,
    bytes: i64,
}

impl<W: Write> ParquetWriter<W> {
    /// A new file with these columns.
    pub fn new(mut out: W, columns: &'static [Column]) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        Ok(Self {
            out,
            columns,
            rows: Vec::new(),
            bytes: 0,
            groups: Vec::new(),
            position: MAGIC.len() as i64,
        })
    }

    /// Add a row: its values in the order of the columns. A column that must be there and is not gets its default.
    pub fn row(&mut self, cells: Vec<Option<Cell>>) -> io::Result<()> {
        self.bytes += cells.iter().map(size_of_cell).sum::<usize>();
        self.rows.push(cells);
        match self.bytes < GROUP_BYTES {
            true => Ok(()),
            false => self.group(),
        }
    }

    /// End the file.
    pub fn finish(mut self) -> io::Result<W> {
        self.group()?;
        let footer = self.footer();
        self.out.write_all(&footer)?;
        self.out.write_all(&(footer.len() as u32).to_le_bytes())?;
        self.out.write_all(MAGIC)?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn group(&mut self) -> io::Result<()> {
        let rows = std::mem::take(&mut self.rows);
        self.bytes = 0;
        if rows.is_empty() {
            return Ok(());
        }
        let mut chunks = Vec::new();
        for (index, column) in self.columns.iter().enumerate() {
            let values = rows
                .iter()
                .map(|row| row.get(index).and_then(Option::as_ref));
            let page = page(column, values);
            let mut header = Compact::default();
            header.i32(1, 0); // type: a data page
            header.i32(2, page.len() as i32);
            header.i32(3, page.len() as i32);
            header.structure(5, |data| {
                data.i32(1, rows.len() as i32);
                data.i32(2, 0); // values: PLAIN
                data.i32(3, 3); // definition levels: RLE
                data.i32(4, 3); // repetition levels: RLE
            });
            let header = header.end();
            self.out.write_all(&header)?;
            self.out.write_all(&page)?;
            let bytes = (header.len() + page.len()) as i64;
            chunks.push(Chunk {
                offset: self.position,
                bytes,
            });
            self.position += bytes;
        }
        self.groups.push(Group {
            rows: rows.len() as i64,
            chunks,
        });
        Ok(())
    }

    /// `FileMetaData`.
    fn footer(&self) -> Vec<u8> {
        let mut meta = Compact::default();
        meta.i32(1, 2);
        meta.list(2, 12, self.columns.len() + 1, |list| {
            list.element(|root| {
                root.binary(4, b"schema");
                root.i32(5, self.columns.len() as i32);
            });
            for column in self.columns {
                list.element(|e| schema_element(e, column));
            }
        });
        meta.i64(3, self.groups.iter().map(|g| g.rows).sum());
        meta.list(4, 12, self.groups.len(), |list| {
            for group in &self.groups {
                list.element(|g| self.row_group(g, group));
            }
        });
        meta.binary(
            6,
            concat!("vergence ", env!("CARGO_PKG_VERSION")).as_bytes(),
        );
        meta.end()
    }

    fn row_group(&self, out: &mut Compact, group: &Group) {
        out.list(1, 12, group.chunks.len(), |list| {
            for (column, chunk) in self.columns.iter().zip(&group.chunks) {
                list.element(|c| {
                    c.i64(2, chunk.offset);
                    c.structure(3, |meta| {
                        meta.i32(1, physical(column.kind));
                        meta.list(2, 5, 2, |encodings| {
                            encodings.zigzag(0);
                            encodings.zigzag(3);
                        });
                        meta.list(3, 8, 1, |path| path.bytes(column.name.as_bytes()));
                        meta.i32(4, 0);
                        meta.i64(5, group.rows);
                        meta.i64(6, chunk.bytes);
                        meta.i64(7, chunk.bytes);
                        meta.i64(9, chunk.offset);
                    });
                });
            }
        });
        out.i64(2, group.chunks.iter().map(|c| c.bytes).sum());
        out.i64(3, group.rows);
    }
}

/// What a value takes in memory.
fn size_of_cell(cell: &Option<Cell>) -> usize {
    let text = match cell {
        Some(Cell::Text(text)) => text.len(),
        _ => 0,
    };
    size_of::<Option<Cell>>() + text
}

/// The numbers of Parquet's physical types: BOOLEAN, INT64, DOUBLE, BYTE_ARRAY.
fn physical(kind: Kind) -> i32 {
    match kind {
        Kind::Flag => 0,
        Kind::Count => 2,
        Kind::Number => 5,
        Kind::Text => 6,
    }
}

fn schema_element(out: &mut Compact, column: &Column) {
    out.i32(1, physical(column.kind));
    out.i32(3, i32::from(column.optional));
    out.binary(4, column.name.as_bytes());
    match column.kind {
        // UTF8, and UINT_64.
        Kind::Text => out.i32(6, 0),
        Kind::Count => out.i32(6, 14),
        _ => {}
    }
}

/// A page: definition levels of an optional column, then the values that are there.
fn page<'a>(column: &Column, values: impl Iterator<Item = Option<&'a Cell>>) -> Vec<u8> {
    let (mut there, mut plain, mut flags) = (Vec::new(), Vec::new(), Vec::new());
    for value in values {
        there.push(value.is_some());
        match (column.kind, value) {
            (_, None) if column.optional => {}
            (Kind::Number, value) => {
                let number = match value {
                    Some(Cell::Number(number)) => *number,
                    _ => 0.0,
                };
                plain.extend(number.to_le_bytes());
            }
            (Kind::Count, value) => {
                let count = match value {
                    Some(Cell::Count(count)) => *count,
                    _ => 0,
                };
                plain.extend(count.to_le_bytes());
            }
            (Kind::Flag, value) => flags.push(value == Some(&Cell::Flag(true))),
            (Kind::Text, value) => {
                let text = match value {
                    Some(Cell::Text(text)) => text.as_str(),
                    _ => "",
                };
                plain.extend((text.len() as u32).to_le_bytes());
                plain.extend(text.as_bytes());
            }
        }
    }
    let mut out = Vec::new();
    if column.optional {
        let levels = runs(&there);
        out.extend((levels.len() as u32).to_le_bytes());
        out.extend(levels);
    }
    out.extend(plain);
    out.extend(bits(&flags));
    out
}

/// Levels of one bit in runs: for each its length twice, then the level.
fn runs(levels: &[bool]) -> Vec<u8> {
    let mut out = Vec::new();
    for run in levels.chunk_by(|a, b| a == b) {
        varint(&mut out, 2 * run.len() as u64);
        out.push(u8::from(run[0]));
    }
    out
}

/// One bit each, the first in the lowest place.
fn bits(flags: &[bool]) -> Vec<u8> {
    flags
        .chunks(8)
        .map(|eight| {
            eight
                .iter()
                .enumerate()
                .fold(0, |byte, (place, flag)| byte | u8::from(*flag) << place)
        })
        .collect()
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A structure of Thrift's compact protocol while it is written; fields in the order of their numbers.
#[derive(Default)]
struct Compact {
    bytes: Vec<u8>,
    last: u8,
}

impl Compact {
    fn field(&mut self, number: u8, kind: u8) {
        // Numbers rise by less than sixteen everywhere here.
        self.bytes.push((number - self.last) << 4 | kind);
        self.last = number;
    }

    fn zigzag(&mut self, value: i64) {
        varint(&mut self.bytes, ((value << 1) ^ (value >> 63)) as u64);
    }

    fn i32(&mut self, number: u8, value: i32) {
        self.field(number, 5);
        self.zigzag(value.into());
    }

    fn i64(&mut self, number: u8, value: i64) {
        self.field(number, 6);
        self.zigzag(value);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        varint(&mut self.bytes, bytes.len() as u64);
        self.bytes.extend(bytes);
    }

    fn binary(&mut self, number: u8, bytes: &[u8]) {
        self.field(number, 8);
        self.bytes(bytes);
    }

    fn structure(&mut self, number: u8, write: impl FnOnce(&mut Compact)) {
        self.field(number, 12);
        self.element(write);
    }

    /// A structure that is an element of a list.
    fn element(&mut self, write: impl FnOnce(&mut Compact)) {
        let mut inner = Compact::default();
        write(&mut inner);
        self.bytes.extend(inner.end());
    }

    fn list(&mut self, number: u8, kind: u8, length: usize, write: impl FnOnce(&mut Compact)) {
        self.field(number, 9);
        if length < 15 {
            self.bytes.push((length as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            varint(&mut self.bytes, length as u64);
        }
        let mut inner = Compact::default();
        write(&mut inner);
        self.bytes.extend(inner.bytes);
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    //! Proves: what waits in memory is bounded by bytes, however long the words are. What is written is read by other programs in `ci/record`.
    use super::*;

    const COLUMNS: &[Column] = &[Column {
        name: "text",
        kind: Kind::Text,
        optional: false,
        meaning: "",
    }];

    #[test]
    fn long_words_end_a_group() {
        let mut writer = ParquetWriter::new(Vec::new(), COLUMNS).unwrap();
        let long = "x".repeat(GROUP_BYTES / 4);
        for _ in 0..10 {
            writer.row(vec![Some(Cell::Text(long.clone()))]).unwrap();
            assert!(writer.bytes < GROUP_BYTES);
        }
        assert_eq!((writer.groups.len(), writer.rows.len()), (2, 2));
        let groups: i64 = writer.groups.iter().map(|g| g.rows).sum();
        assert_eq!(groups, 8);
        assert!(writer.finish().unwrap().ends_with(MAGIC));
    }
}
