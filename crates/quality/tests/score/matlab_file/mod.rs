//! Writes small MATLAB level-5 files, byte by byte from the description of the format, for the reader to read.

/// An array with its name and contents.
pub(crate) enum Array {
    /// Full, column after column; small whole numbers are stored as bytes, as MATLAB does.
    Full([usize; 2], Vec<f64>),
    /// Sparse: rows, columns, and the full matrix column after column.
    Sparse([usize; 2], Vec<f64>),
    /// Cells.
    Cell([usize; 2], Vec<Array>),
    /// One structure.
    Struct(Vec<(&'static str, Array)>),
    /// Text.
    Text(&'static str),
}

/// A row of numbers.
pub(crate) fn row(values: &[f64]) -> Array {
    Array::Full([1, values.len()], values.to_vec())
}

/// A column of numbers.
pub(crate) fn column(values: &[f64]) -> Array {
    Array::Full([values.len(), 1], values.to_vec())
}

/// A file of variables.
pub(crate) fn file(variables: &[(&str, Array)], compressed: bool) -> Vec<u8> {
    let mut out = header();
    for (name, array) in variables {
        let plain = matrix(name, array);
        if compressed {
            let deflated = miniz_oxide::deflate::compress_to_vec_zlib(&plain, 6);
            out.extend(tag(15, deflated.len()));
            out.extend(deflated);
        } else {
            out.extend(plain);
        }
    }
    out
}

pub(crate) fn header() -> Vec<u8> {
    let mut out = b"MATLAB 5.0 MAT-file, written by a test".to_vec();
    out.resize(124, b' ');
    out.extend([0x00, 0x01, b'I', b'M']);
    out
}

pub(crate) fn tag(kind: u32, length: usize) -> Vec<u8> {
    [kind.to_le_bytes(), (length as u32).to_le_bytes()].concat()
}

/// An element, filled up to eight bytes; up to four bytes go into the tag.
pub(crate) fn element(kind: u32, body: &[u8]) -> Vec<u8> {
    if (1..=4).contains(&body.len()) {
        let mut out = (kind | (body.len() as u32) << 16).to_le_bytes().to_vec();
        out.extend(body);
        out.resize(8, 0);
        return out;
    }
    let mut out = tag(kind, body.len());
    out.extend(body);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

fn ints(values: &[usize]) -> Vec<u8> {
    let bytes = values.iter().flat_map(|v| (*v as i32).to_le_bytes());
    element(5, &bytes.collect::<Vec<u8>>())
}

fn numbers(values: &[f64]) -> Vec<u8> {
    if values
        .iter()
        .all(|v| (0.0..256.0).contains(v) && v.fract() == 0.0)
    {
        return element(2, &values.iter().map(|v| *v as u8).collect::<Vec<u8>>());
    }
    let bytes = values.iter().flat_map(|v| v.to_le_bytes());
    element(9, &bytes.collect::<Vec<u8>>())
}

/// The array as an element of type matrix.
pub(crate) fn matrix(name: &str, array: &Array) -> Vec<u8> {
    let (class, size) = match array {
        Array::Cell(size, _) => (1, *size),
        Array::Struct(_) => (2, [1, 1]),
        Array::Text(text) => (4, [1, text.len()]),
        Array::Sparse(size, _) => (5, *size),
        Array::Full(size, _) => (6, *size),
    };
    let mut body = element(6, &[class, 0, 0, 0, 0, 0, 0, 0]);
    body.extend(ints(&size));
    body.extend(element(1, name.as_bytes()));
    match array {
        Array::Full(_, values) => body.extend(numbers(values)),
        Array::Text(text) => body.extend(element(16, text.as_bytes())),
        Array::Cell(_, cells) => body.extend(cells.iter().flat_map(|c| matrix("", c))),
        Array::Sparse([rows, columns], values) => {
            let (mut places, mut starts, mut kept) = (vec![], vec![0], vec![]);
            for column in 0..*columns {
                for row in 0..*rows {
                    let value = values[column * rows + row];
                    if value != 0.0 {
                        places.push(row);
                        kept.push(value);
                    }
                }
                starts.push(kept.len());
            }
            body.extend(ints(&places));
            body.extend(ints(&starts));
            body.extend(numbers(&kept));
        }
        Array::Struct(fields) => {
            body.extend(ints(&[32]));
            let mut names = Vec::new();
            for (name, _) in fields {
                names.extend(name.as_bytes());
                names.resize(names.len().next_multiple_of(32), 0);
            }
            body.extend(element(1, &names));
            body.extend(fields.iter().flat_map(|(_, a)| matrix("", a)));
        }
    }
    let mut out = tag(14, body.len());
    out.extend(body);
    out
}
