//! MATLAB level-5 files (`save -v6` and `-v7`), read with limits.
//!
//! Layout: MATLAB, "MAT-File Format". Read are numeric arrays (real, stored in any width), sparse matrices, cell arrays and structures, plain
//! or compressed, little-endian. Everything else is skipped where nobody asks for it and refused where somebody does.

use std::collections::BTreeMap;

use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;

use super::error::ModelError;

/// Most bytes that one compressed variable may inflate to.
const MAX_INFLATED: usize = 128 << 20;

/// Most that is kept of one file, in numbers of eight bytes.
const MAX_VALUES: usize = 16 << 20;

/// What a cell or a field takes beside its contents, counted as numbers.
const CELL: usize = 16;

/// Deepest nesting of cells and structures.
const MAX_DEPTH: usize = 8;

/// Most variables in a file.
const MAX_VARIABLES: usize = 4096;

/// Bytes before the first variable.
const HEADER: usize = 128;

/// Every level-5 file of MATLAB begins so.
pub const START: &[u8] = b"MATLAB 5.0 MAT-file";

/// A value of MATLAB.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A full matrix, column after column.
    Full {
        /// Rows and columns.
        size: [usize; 2],
        /// `size[0] * size[1]` values.
        values: Vec<f64>,
    },
    /// A sparse matrix.
    Sparse {
        /// Rows and columns.
        size: [usize; 2],
        /// Row, column and value of each entry that is stored; all inside `size`.
        entries: Vec<(usize, usize, f64)>,
    },
    /// A cell array, column after column.
    Cell(Vec<Value>),
    /// A structure or an array of structures: one map from field to value for each.
    Struct(Vec<BTreeMap<String, Value>>),
    /// Something that is not read: text, objects, complex numbers.
    Other(&'static str),
}

impl Value {
    /// What it is, for messages: "a 3 x 4 matrix".
    pub fn kind(&self) -> String {
        match self {
            Value::Full { size: [r, c], .. } => format!("a {r} x {c} matrix"),
            Value::Sparse { size: [r, c], .. } => format!("a sparse {r} x {c} matrix"),
            Value::Cell(cells) => format!("a cell array of {}", cells.len()),
            Value::Struct(all) => format!("a structure array of {}", all.len()),
            Value::Other(what) => (*what).to_owned(),
        }
    }
}

/// The variables of a file that have one of these names.
///
/// # Errors
/// A file that is not MATLAB's, of another version, cut short, garbled, or beyond the limits.
pub fn variables(bytes: &[u8], wanted: &[&str]) -> Result<BTreeMap<String, Value>, ModelError> {
    check_header(bytes)?;
    let mut out = BTreeMap::new();
    let mut rest = &bytes[HEADER..];
    let mut budget = MAX_VALUES;
    for count in 0.. {
        if rest.is_empty() {
            break;
        }
        if count == MAX_VARIABLES {
            return Err(broken(format!("more than {MAX_VARIABLES} variables")));
        }
        let element = Element::first(&mut rest, Padding::OfPlain)?;
        let inflated;
        let body = match element.kind {
            kind::COMPRESSED => {
                inflated = inflate(element.body)?;
                let mut inner = inflated.as_slice();
                let inside = Element::first(&mut inner, Padding::Always)?;
                if inside.kind != kind::MATRIX {
                    continue;
                }
                inside.body
            }
            kind::MATRIX => element.body,
            _ => continue,
        };
        let mut reader = Reader {
            budget: &mut budget,
        };
        if let Some((name, value)) = reader.variable(body, wanted)? {
            out.insert(name, value);
        }
    }
    Ok(out)
}

fn broken(reason: impl Into<String>) -> ModelError {
    ModelError::Matlab {
        reason: reason.into(),
    }
}

fn cut_short() -> ModelError {
    broken("its data break off")
}

fn check_header(bytes: &[u8]) -> Result<(), ModelError> {
    if bytes.starts_with(b"MATLAB 7.3 MAT-file") || bytes.starts_with(b"\x89HDF") {
        return Err(broken(
            "it is of version 7.3 (HDF5); save it with -v7 to have it read",
        ));
    }
    if !bytes.starts_with(START) {
        return Err(broken("its header is another"));
    }
    let header = bytes.get(..HEADER).ok_or_else(cut_short)?;
    match [header[126], header[127]] {
        [b'I', b'M'] => Ok(()),
        [b'M', b'I'] => Err(broken("it is big-endian; save it on another machine")),
        _ => Err(broken("its header has no byte order")),
    }
}

fn inflate(bytes: &[u8]) -> Result<Vec<u8>, ModelError> {
    decompress_to_vec_zlib_with_limit(bytes, MAX_INFLATED).map_err(|e| {
        use miniz_oxide::inflate::TINFLStatus;
        match e.status {
            TINFLStatus::HasMoreOutput => broken(format!(
                "a variable inflates to more than {} MiB",
                MAX_INFLATED >> 20
            )),
            TINFLStatus::FailedCannotMakeProgress | TINFLStatus::NeedsMoreInput => cut_short(),
            TINFLStatus::Adler32Mismatch => broken("a checksum does not fit"),
            _ => broken("its compressed data are garbled"),
        }
    })
}

/// Types of elements.
mod kind {
    pub(super) const INT8: u32 = 1;
    pub(super) const UINT8: u32 = 2;
    pub(super) const INT16: u32 = 3;
    pub(super) const UINT16: u32 = 4;
    pub(super) const INT32: u32 = 5;
    pub(super) const UINT32: u32 = 6;
    pub(super) const SINGLE: u32 = 7;
    pub(super) const DOUBLE: u32 = 9;
    pub(super) const INT64: u32 = 12;
    pub(super) const UINT64: u32 = 13;
    pub(super) const MATRIX: u32 = 14;
    pub(super) const COMPRESSED: u32 = 15;
}

/// Whether compressed elements are filled up to eight bytes too (at the top of a file they are not).
#[derive(Clone, Copy, PartialEq)]
enum Padding {
    Always,
    OfPlain,
}

/// A tagged piece of data.
struct Element<'a> {
    kind: u32,
    body: &'a [u8],
}

impl<'a> Element<'a> {
    /// Take the first element off.
    fn first(rest: &mut &'a [u8], padding: Padding) -> Result<Self, ModelError> {
        let tag = u32_at(rest, 0)?;
        if tag >> 16 != 0 {
            // Up to four bytes inside the tag.
            let length = (tag >> 16) as usize;
            if length > 4 {
                return Err(broken("a small element has more than 4 bytes"));
            }
            let whole = rest.get(..8).ok_or_else(cut_short)?;
            *rest = &rest[8..];
            return Ok(Self {
                kind: tag & 0xffff,
                body: &whole[4..4 + length],
            });
        }
        let length = u32_at(rest, 4)? as usize;
        let end = length.checked_add(8).ok_or_else(cut_short)?;
        let body = rest.get(8..end).ok_or_else(cut_short)?;
        let filled = match (padding, tag) {
            (Padding::OfPlain, kind::COMPRESSED) => end,
            _ => end.next_multiple_of(8),
        };
        *rest = &rest[filled.min(rest.len())..];
        Ok(Self { kind: tag, body })
    }

    /// How many numbers it has at most.
    fn count(&self) -> usize {
        self.body.len()
            / match self.kind {
                kind::INT8 | kind::UINT8 => 1,
                kind::INT16 | kind::UINT16 => 2,
                kind::INT32 | kind::UINT32 | kind::SINGLE => 4,
                _ => 8,
            }
    }

    /// Its numbers, whatever their width; integers beyond 2^53 are rounded.
    fn numbers(&self) -> Result<Vec<f64>, ModelError> {
        fn each<const N: usize>(body: &[u8], f: impl Fn([u8; N]) -> f64) -> Option<Vec<f64>> {
            let (chunks, rest) = body.as_chunks::<N>();
            rest.is_empty()
                .then(|| chunks.iter().map(|c| f(*c)).collect())
        }
        let b = self.body;
        let numbers = match self.kind {
            kind::INT8 => each(b, |c| f64::from(i8::from_le_bytes(c))),
            kind::UINT8 => each(b, |[c]| f64::from(c)),
            kind::INT16 => each(b, |c| f64::from(i16::from_le_bytes(c))),
            kind::UINT16 => each(b, |c| f64::from(u16::from_le_bytes(c))),
            kind::INT32 => each(b, |c| f64::from(i32::from_le_bytes(c))),
            kind::UINT32 => each(b, |c| f64::from(u32::from_le_bytes(c))),
            kind::SINGLE => each(b, |c| f64::from(f32::from_le_bytes(c))),
            kind::DOUBLE => each(b, f64::from_le_bytes),
            kind::INT64 => each(b, |c| i64::from_le_bytes(c) as f64),
            kind::UINT64 => each(b, |c| u64::from_le_bytes(c) as f64),
            other => return Err(broken(format!("numbers of unknown type {other}"))),
        };
        numbers.ok_or_else(|| broken("a run of numbers has a fraction of one"))
    }

    /// Its numbers as places or counts.
    fn counts(&self) -> Result<Vec<usize>, ModelError> {
        let whole = |v: f64| (v >= 0.0 && v <= f64::from(i32::MAX)).then_some(v as usize);
        let counts: Option<Vec<usize>> = self.numbers()?.into_iter().map(whole).collect();
        counts.ok_or_else(|| broken("a count is negative"))
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Result<u32, ModelError> {
    let four = bytes.get(at..at + 4).ok_or_else(cut_short)?;
    Ok(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
}

/// What stands before the contents of an array.
struct Head {
    class: u8,
    complex: bool,
    dims: Vec<usize>,
    name: String,
}

impl Head {
    fn first(rest: &mut &[u8]) -> Result<Self, ModelError> {
        let flags = Element::first(rest, Padding::Always)?;
        let flags = u32_at(flags.body, 0)?;
        let dims = Element::first(rest, Padding::Always)?.counts()?;
        let name = Element::first(rest, Padding::Always)?;
        Ok(Self {
            class: (flags & 0xff) as u8,
            complex: flags & 0x800 != 0,
            dims,
            name: String::from_utf8_lossy(name.body).into_owned(),
        })
    }

    /// Rows and columns; arrays of more dimensions count their columns together.
    fn size(&self) -> Result<[usize; 2], ModelError> {
        let [rows, columns @ ..] = self.dims.as_slice() else {
            return Err(broken("an array has no size"));
        };
        let columns = columns.iter().try_fold(1_usize, |p, d| p.checked_mul(*d));
        let columns = columns.ok_or_else(|| broken("an array is too large"))?;
        rows.checked_mul(columns)
            .filter(|n| *n <= MAX_VALUES)
            .ok_or_else(|| broken(format!("an array has more than {MAX_VALUES} values")))?;
        Ok([*rows, columns])
    }
}

struct Reader<'a> {
    /// Values that may still be kept.
    budget: &'a mut usize,
}

impl Reader<'_> {
    /// Name and value of a variable, when it is wanted.
    fn variable(
        &mut self,
        body: &[u8],
        wanted: &[&str],
    ) -> Result<Option<(String, Value)>, ModelError> {
        let mut rest = body;
        let flags = Element::first(&mut &*rest, Padding::Always)?;
        if u32_at(flags.body, 0)? & 0xff > 15 {
            // Function handles and objects have other heads; nobody wants one.
            return Ok(None);
        }
        let head = Head::first(&mut rest)?;
        if !wanted.contains(&head.name.as_str()) {
            return Ok(None);
        }
        let value = self.contents(&head, rest, 0)?;
        Ok(Some((head.name, value)))
    }

    fn spend(&mut self, values: usize) -> Result<(), ModelError> {
        *self.budget = (self.budget.checked_sub(values))
            .ok_or_else(|| broken(format!("it holds more than {MAX_VALUES} values")))?;
        Ok(())
    }

    fn matrix(&mut self, rest: &mut &[u8], depth: usize) -> Result<Value, ModelError> {
        if depth > MAX_DEPTH {
            return Err(broken(format!("it is nested deeper than {MAX_DEPTH}")));
        }
        self.spend(CELL)?;
        let element = Element::first(rest, Padding::Always)?;
        if element.kind != kind::MATRIX {
            return Err(broken("a cell or field holds no array"));
        }
        let mut body = element.body;
        if body.is_empty() {
            return Ok(Value::Full {
                size: [0, 0],
                values: Vec::new(),
            });
        }
        let head = Head::first(&mut body)?;
        self.contents(&head, body, depth)
    }

    fn contents(&mut self, head: &Head, rest: &[u8], depth: usize) -> Result<Value, ModelError> {
        if head.complex {
            return Ok(Value::Other("an array of complex numbers"));
        }
        match head.class {
            1 => self.cell(head, rest, depth),
            2 => self.structure(head, rest, depth),
            4 => Ok(Value::Other("text")),
            5 => self.sparse(head, rest),
            6..=15 => self.full(head, rest),
            _ => Ok(Value::Other("an object")),
        }
    }

    fn full(&mut self, head: &Head, mut rest: &[u8]) -> Result<Value, ModelError> {
        let size = head.size()?;
        let element = Element::first(&mut rest, Padding::Always)?;
        self.spend(element.count())?;
        let values = element.numbers()?;
        if values.len() != size[0] * size[1] {
            return Err(broken(format!(
                "a {} x {} matrix has {} values",
                size[0],
                size[1],
                values.len()
            )));
        }
        Ok(Value::Full { size, values })
    }

    fn sparse(&mut self, head: &Head, mut rest: &[u8]) -> Result<Value, ModelError> {
        let [rows, columns] = match head.dims.as_slice() {
            [rows, columns] => [*rows, *columns],
            _ => return Err(broken("a sparse matrix has not two sizes")),
        };
        let places = Element::first(&mut rest, Padding::Always)?;
        let starts = Element::first(&mut rest, Padding::Always)?;
        let values = Element::first(&mut rest, Padding::Always)?;
        self.spend(2 * places.count() + starts.count() + 3 * values.count())?;
        let (places, starts, values) = (places.counts()?, starts.counts()?, values.numbers()?);
        let count = starts.last().copied().unwrap_or(0);
        let ordered = starts.first() == Some(&0) && starts.is_sorted();
        // More room than entries is allowed.
        if starts.len() != columns + 1 || !ordered || count > places.len() || count > values.len() {
            return Err(broken("a sparse matrix does not fit its size"));
        }
        let mut entries = Vec::with_capacity(count);
        for column in 0..columns {
            for at in starts[column]..starts[column + 1] {
                if places[at] >= rows {
                    return Err(broken("a sparse matrix has an entry outside"));
                }
                entries.push((places[at], column, values[at]));
            }
        }
        Ok(Value::Sparse {
            size: [rows, columns],
            entries,
        })
    }

    fn cell(&mut self, head: &Head, mut rest: &[u8], depth: usize) -> Result<Value, ModelError> {
        let [rows, columns] = head.size()?;
        let mut cells = Vec::new();
        for _ in 0..rows * columns {
            cells.push(self.matrix(&mut rest, depth + 1)?);
        }
        Ok(Value::Cell(cells))
    }

    fn structure(
        &mut self,
        head: &Head,
        mut rest: &[u8],
        depth: usize,
    ) -> Result<Value, ModelError> {
        let [rows, columns] = head.size()?;
        let length = Element::first(&mut rest, Padding::Always)?.counts()?;
        let length = match length.as_slice() {
            [length @ 1..=64] => *length,
            _ => return Err(broken("a structure's names of fields have no length")),
        };
        let names = Element::first(&mut rest, Padding::Always)?;
        if names.body.len() % length != 0 {
            return Err(broken("a structure's names of fields are garbled"));
        }
        let names: Vec<String> = names.body.chunks(length).map(name_from).collect();
        let mut all = Vec::new();
        for _ in 0..rows * columns {
            self.spend(CELL)?;
            let mut fields = BTreeMap::new();
            for name in &names {
                fields.insert(name.clone(), self.matrix(&mut rest, depth + 1)?);
            }
            all.push(fields);
        }
        Ok(Value::Struct(all))
    }
}

/// Up to the first zero.
fn name_from(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}
