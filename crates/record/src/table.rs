//! Rows of plain numbers and words: how our own messages are declared, written as protocol buffers, and read back.

use crate::error::RecordError;
use crate::proto::{self, Message, Value};
use crate::schema::{FieldOf, Label, Type, descriptor_of_flat};

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Number,
    /// A whole number from 0.
    Count,
    /// Yes or no.
    Flag,
    /// Words.
    Text,
}

/// A column of a kind of row.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its name, its unit last.
    pub name: &'static str,
    /// What it holds.
    pub kind: Kind,
    /// Whether a row may lack it.
    pub optional: bool,
    /// What it means, with frame and sign.
    pub meaning: &'static str,
}

/// A value of a row.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A number, every bit of it.
    Number(f64),
    /// A whole number.
    Count(u64),
    /// Yes or no.
    Flag(bool),
    /// Words.
    Text(String),
}

/// A kind of row, and with it a channel of a recording.
pub trait Row: Sized {
    /// Name of the message within the package `vergence`.
    const NAME: &'static str;
    /// Its columns; field numbers count from 1 in this order.
    const COLUMNS: &'static [Column];

    /// The values in the order of the columns.
    fn cells(&self) -> Vec<Option<Cell>>;

    /// A row from values in the order of the columns; columns that are not there are at their default.
    fn from_cells(cells: Vec<Option<Cell>>) -> Self;

    /// As a protocol buffer.
    fn encode(&self) -> Vec<u8> {
        encode(Self::COLUMNS, &self.cells())
    }

    /// From a protocol buffer; fields that are not known are passed over.
    fn decode(bytes: &[u8]) -> Result<Self, RecordError> {
        Ok(Self::from_cells(decode(Self::COLUMNS, bytes)?))
    }
}

/// A row as a protocol buffer.
fn encode(columns: &[Column], cells: &[Option<Cell>]) -> Vec<u8> {
    let mut message = Message::new();
    for (index, (column, cell)) in columns.iter().zip(cells).enumerate() {
        let number = index as u32 + 1;
        match (cell, column.optional) {
            (None, _) => {}
            (Some(Cell::Number(value)), false) => {
                message.double(number, *value);
            }
            (Some(Cell::Number(value)), true) => message.present().double(number, *value),
            (Some(Cell::Count(value)), false) => {
                message.varint(number, *value);
            }
            (Some(Cell::Count(value)), true) => message.present().varint(number, *value),
            (Some(Cell::Flag(value)), false) => {
                message.varint(number, u64::from(*value));
            }
            (Some(Cell::Flag(value)), true) => message.present().varint(number, u64::from(*value)),
            (Some(Cell::Text(text)), false) => {
                message.string(number, text);
            }
            (Some(Cell::Text(text)), true) => message.present().bytes(number, text.as_bytes()),
        }
    }
    message.into_bytes()
}

/// Values of a row in the order of `columns`; what a column that must be there lacks is its default.
pub fn decode(columns: &[Column], bytes: &[u8]) -> Result<Vec<Option<Cell>>, RecordError> {
    let mut cells: Vec<Option<Cell>> = columns
        .iter()
        .map(|column| (!column.optional).then(|| column.kind.default()))
        .collect();
    for field in proto::fields(bytes) {
        let field = field?;
        let index = field.number as usize - 1;
        if let Some(column) = columns.get(index) {
            let cell = column.kind.cell(field.value).ok_or_else(|| {
                RecordError::Message(format!("the field {} is of another type", column.name))
            })?;
            cells[index] = Some(cell);
        }
    }
    Ok(cells)
}

impl Kind {
    fn default(self) -> Cell {
        match self {
            Kind::Number => Cell::Number(0.0),
            Kind::Count => Cell::Count(0),
            Kind::Flag => Cell::Flag(false),
            Kind::Text => Cell::Text(String::new()),
        }
    }

    fn cell(self, value: Value<'_>) -> Option<Cell> {
        Some(match self {
            Kind::Number => Cell::Number(value.double()?),
            Kind::Count => Cell::Count(value.varint()?),
            Kind::Flag => Cell::Flag(value.varint()? != 0),
            Kind::Text => Cell::Text(value.text()?.to_owned()),
        })
    }

    fn wire(self) -> Type {
        match self {
            Kind::Number => Type::Double,
            Kind::Count => Type::Uint64,
            Kind::Flag => Type::Bool,
            Kind::Text => Type::String,
        }
    }
}

/// The descriptor of a kind of row.
pub fn descriptor(name: &str, columns: &[Column]) -> Vec<u8> {
    let fields: Vec<FieldOf> = columns
        .iter()
        .enumerate()
        .map(|(index, column)| FieldOf {
            name: column.name,
            number: index as u32 + 1,
            kind: column.kind.wire(),
            label: if column.optional {
                Label::Optional
            } else {
                Label::One
            },
        })
        .collect();
    descriptor_of_flat(name, &fields)
}

/// What a field of a row's struct may be.
pub trait Plain {
    /// What its column holds.
    const KIND: Kind;
    /// Whether it may be missing.
    const OPTIONAL: bool;
    /// As a value.
    fn into_cell(self) -> Option<Cell>;
    /// From a value.
    fn from_cell(cell: Option<Cell>) -> Self;
}

macro_rules! plain {
    ($type:ty, $kind:ident) => {
        impl Plain for $type {
            const KIND: Kind = Kind::$kind;
            const OPTIONAL: bool = false;
            fn into_cell(self) -> Option<Cell> {
                Some(Cell::$kind(self))
            }
            fn from_cell(cell: Option<Cell>) -> Self {
                match cell {
                    Some(Cell::$kind(value)) => value,
                    _ => Self::default(),
                }
            }
        }

        impl Plain for Option<$type> {
            const KIND: Kind = Kind::$kind;
            const OPTIONAL: bool = true;
            fn into_cell(self) -> Option<Cell> {
                self.map(Cell::$kind)
            }
            fn from_cell(cell: Option<Cell>) -> Self {
                match cell {
                    Some(Cell::$kind(value)) => Some(value),
                    _ => None,
                }
            }
        }
    };
}

plain!(f64, Number);
plain!(u64, Count);
plain!(bool, Flag);
plain!(String, Text);

/// Declares a kind of row: a struct whose fields are its columns, each with what it means.
macro_rules! row {
    ($(#[$about:meta])* $name:ident { $($field:ident: $type:ty = $meaning:literal,)* }) => {
        $(#[$about])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $name {
            $(#[doc = $meaning] pub $field: $type,)*
        }

        impl $crate::table::Row for $name {
            const NAME: &'static str = stringify!($name);
            const COLUMNS: &'static [$crate::table::Column] = &[
                $($crate::table::Column {
                    name: stringify!($field),
                    kind: <$type as $crate::table::Plain>::KIND,
                    optional: <$type as $crate::table::Plain>::OPTIONAL,
                    meaning: $meaning,
                },)*
            ];

            fn cells(&self) -> Vec<Option<$crate::table::Cell>> {
                vec![$($crate::table::Plain::into_cell(self.$field.clone()),)*]
            }

            fn from_cells(cells: Vec<Option<$crate::table::Cell>>) -> Self {
                let mut cells = cells.into_iter();
                Self {
                    $($field: $crate::table::Plain::from_cell(cells.next().flatten()),)*
                }
            }
        }
    };
}

pub(crate) use row;
