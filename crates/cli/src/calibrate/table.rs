//! Tables with commas that belong to pictures: a head, rows, empty lines and remarks (`#`) passed over.

/// A table as it was read; every row has as many cells as the head.
pub(super) struct Table<'a> {
    head: Vec<&'a str>,
    rows: Vec<Row<'a>>,
}

/// One row.
pub(super) struct Row<'a> {
    /// Number of its line, from 1.
    pub(super) line: usize,
    cells: Vec<&'a str>,
}

impl<'a> Table<'a> {
    /// Read a table; an error says what is wrong and in which line.
    pub(super) fn parse(text: &'a str) -> Result<Self, String> {
        let cells = |line: &'a str| line.split(',').map(str::trim).collect::<Vec<_>>();
        let mut lines = (text.lines().enumerate())
            .map(|(i, line)| (i + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let (_, head) = lines.next().ok_or("it is empty")?;
        let head = cells(head);
        let rows = lines.map(|(line, text)| {
            let cells = cells(text);
            match cells.len() == head.len() {
                true => Ok(Row { line, cells }),
                false => Err(format!(
                    "line {line} has {} values, its head {}",
                    cells.len(),
                    head.len()
                )),
            }
        });
        Ok(Self {
            rows: rows.collect::<Result<_, _>>()?,
            head,
        })
    }

    /// Place of a column.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.head.iter().position(|c| *c == name)
    }

    /// All rows in their order.
    pub(super) fn rows(&self) -> &[Row<'a>] {
        &self.rows
    }

    /// A finite number of a row.
    pub(super) fn number(&self, row: &Row<'_>, column: usize) -> Result<f64, String> {
        let value: f64 = row.cells[column].parse().unwrap_or(f64::NAN);
        value.is_finite().then_some(value).ok_or_else(|| {
            format!(
                "line {}, column {}: \"{}\" is no number",
                row.line, self.head[column], row.cells[column]
            )
        })
    }
}

impl<'a> Row<'a> {
    /// Text of a column.
    pub(super) fn text(&self, column: usize) -> &'a str {
        self.cells[column]
    }
}
