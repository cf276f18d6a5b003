//! Rows of every channel as CSV and Parquet.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use vergence_record::Topic;
use vergence_record::parquet::ParquetWriter;
use vergence_record::table::Cell;

use crate::fault::{self, Fault};

/// The tables of an export while they are written.
pub(super) struct Numbers {
    folder: PathBuf,
    tables: BTreeMap<&'static str, Table>,
}

struct Table {
    csv: BufWriter<File>,
    parquet: ParquetWriter<BufWriter<File>>,
    rows: u64,
}

fn cannot(path: &Path, e: &std::io::Error) -> Fault {
    fault::failed(format!("cannot write {}: {e}", path.display()))
}

impl Numbers {
    pub(super) fn new(folder: &Path) -> Result<Self, Fault> {
        let folder = folder.join("numbers");
        std::fs::create_dir_all(&folder).map_err(|e| cannot(&folder, &e))?;
        Ok(Self {
            folder,
            tables: BTreeMap::new(),
        })
    }

    /// Add a row to the table of its channel.
    pub(super) fn take(&mut self, topic: Topic, cells: Vec<Option<Cell>>) -> Result<(), Fault> {
        let Some((_, columns)) = topic.row() else {
            return Ok(());
        };
        let name = topic.name().trim_start_matches('/');
        if !self.tables.contains_key(name) {
            let file = |extension: &str| {
                let path = self.folder.join(format!("{name}.{extension}"));
                let file = File::create(&path).map_err(|e| cannot(&path, &e))?;
                Ok::<_, Fault>(BufWriter::new(file))
            };
            let mut csv = file("csv")?;
            let parquet = ParquetWriter::new(file("parquet")?, columns);
            let names: Vec<_> = columns.iter().map(|c| c.name).collect();
            writeln!(csv, "{}", names.join(",")).map_err(|e| cannot(&self.folder, &e))?;
            let parquet = parquet.map_err(|e| cannot(&self.folder, &e))?;
            self.tables.insert(
                name,
                Table {
                    csv,
                    parquet,
                    rows: 0,
                },
            );
        }
        let Some(table) = self.tables.get_mut(name) else {
            return Ok(());
        };
        let line: Vec<String> = cells.iter().map(text).collect();
        table.rows += 1;
        writeln!(table.csv, "{}", line.join(","))
            .and_then(|()| table.parquet.row(cells))
            .map_err(|e| cannot(&self.folder, &e))
    }

    /// End all files; rows by table.
    pub(super) fn finish(self) -> Result<BTreeMap<&'static str, u64>, Fault> {
        let mut rows = BTreeMap::new();
        for (name, mut table) in self.tables {
            table
                .csv
                .flush()
                .and_then(|()| table.parquet.finish().map(drop))
                .map_err(|e| cannot(&self.folder, &e))?;
            rows.insert(name, table.rows);
        }
        Ok(rows)
    }
}

/// A value as CSV has it: numbers with every digit, text in quotes where it needs them.
fn text(cell: &Option<Cell>) -> String {
    match cell {
        None => String::new(),
        Some(Cell::Number(number)) => number.to_string(),
        Some(Cell::Count(count)) => count.to_string(),
        Some(Cell::Flag(flag)) => u8::from(*flag).to_string(),
        Some(Cell::Text(text)) if text.contains([',', '"', '\n', '\r']) => {
            format!("\"{}\"", text.replace('"', "\"\""))
        }
        Some(Cell::Text(text)) => text.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Text that would break out of its cell is quoted; numbers read back as they were.
    #[test]
    fn cells() {
        let quoted = text(&Some(Cell::Text("a, \"b\"\n".to_owned())));
        assert_eq!(quoted, "\"a, \"\"b\"\"\n\"");
        let number = 0.1 + 0.2;
        assert_eq!(text(&Some(Cell::Number(number))).parse(), Ok(number));
    }
}
