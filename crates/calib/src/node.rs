//! A tree of texts, lists and maps: what YAML and OpenCV's XML have in common.
//!
//! Aliases are refused (a few lines of them unfold to gigabytes), and so are duplicate keys, several documents, deep nesting and more
//! values than any calibration has. The tree is built without recursion, so that no file can exhaust the stack.

use saphyr_parser::{Event, Parser};

/// Deepest nesting that is read; calibrations have about five.
pub(crate) const MAX_DEPTH: usize = 32;

/// Most values in one file: a calibration that carries all its corners (200 views of 1,000 corners) has 400,000.
const MAX_NODES: usize = 1_000_000;

/// One value of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Node {
    /// Text or number, as it stands in the file.
    Scalar(String),
    /// A list.
    List(Vec<Node>),
    /// A map, in the file's order; no key occurs twice.
    Map(Vec<(String, Node)>),
}

impl Node {
    /// A value of a map; `None` for another kind of node or a key that is not there.
    pub(crate) fn get(&self, key: &str) -> Option<&Self> {
        self.entries()
            .iter()
            .find(|(k, _)| k == key)
            .map(|(_, value)| value)
    }

    /// The entries of a map; none for another kind of node.
    pub(crate) fn entries(&self) -> &[(String, Self)] {
        match self {
            Self::Map(entries) => entries,
            Self::Scalar(_) | Self::List(_) => &[],
        }
    }

    /// The text of a scalar.
    pub(crate) fn text(&self) -> Result<&str, String> {
        match self {
            Self::Scalar(text) => Ok(text.trim()),
            Self::List(_) => Err("is a list; one value is expected".to_owned()),
            Self::Map(_) => Err("is a map; one value is expected".to_owned()),
        }
    }

    /// A whole number from 0.
    pub(crate) fn count(&self) -> Result<usize, String> {
        let text = self.text()?;
        text.parse()
            .map_err(|_| format!("is {text:?}; a whole number is expected"))
    }

    /// The numbers of a list, or of a text that holds them between spaces (XML).
    pub(crate) fn numbers(&self) -> Result<Vec<f64>, String> {
        match self {
            Self::List(items) => items.iter().map(|i| i.text().and_then(number)).collect(),
            Self::Scalar(text) => text.split_ascii_whitespace().map(number).collect(),
            Self::Map(_) => Err("is a map; numbers are expected".to_owned()),
        }
    }

    /// A matrix: `rows`, `cols` and `data` (OpenCV and ROS), `sizes` and `data` (OpenCV from version 5), or a list of rows (Kalibr).
    pub(crate) fn matrix(&self) -> Result<Matrix, String> {
        match self {
            Self::List(rows) if matches!(rows.first(), Some(Self::List(_))) => {
                let rows: Vec<Vec<f64>> =
                    rows.iter().map(Self::numbers).collect::<Result<_, _>>()?;
                let cols = rows[0].len();
                if rows.iter().any(|row| row.len() != cols) {
                    return Err("has rows of unequal length".to_owned());
                }
                Ok(Matrix {
                    rows: rows.len(),
                    cols,
                    data: rows.concat(),
                })
            }
            Self::Map(_) => self.matrix_from_map(),
            Self::List(_) | Self::Scalar(_) => {
                let data = self.numbers()?;
                Ok(Matrix {
                    rows: 1,
                    cols: data.len(),
                    data,
                })
            }
        }
    }

    fn matrix_from_map(&self) -> Result<Matrix, String> {
        let needed = |key: &str| {
            self.get(key)
                .ok_or_else(|| format!("has no {key}; a matrix is expected"))
        };
        if let Some(dt) = self.get("dt")
            && !matches!(dt.text()?, "d" | "f" | "i" | "u" | "c" | "w" | "s")
        {
            return Err(format!(
                "has the element type {:?}; a matrix of one channel is expected",
                dt.text()?
            ));
        }
        let (rows, cols) = match self.get("sizes") {
            None => (needed("rows")?.count()?, needed("cols")?.count()?),
            Some(sizes) => match sizes.numbers()?[..] {
                [n] => (1, n as usize),
                [r, c] => (r as usize, c as usize),
                _ => return Err("has neither one nor two dimensions".to_owned()),
            },
        };
        let data = needed("data")?.numbers()?;
        if rows.checked_mul(cols) != Some(data.len()) {
            return Err(format!("is {rows}x{cols} with {} values", data.len()));
        }
        Ok(Matrix { rows, cols, data })
    }
}

/// A matrix as it stands in a file.
pub(crate) struct Matrix {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Row by row, all finite.
    pub(crate) data: Vec<f64>,
}

impl Matrix {
    /// The rows of a matrix of exactly `R` rows and `C` columns.
    pub(crate) fn rows<const R: usize, const C: usize>(&self) -> Result<[[f64; C]; R], String> {
        if (self.rows, self.cols) != (R, C) {
            return Err(format!(
                "is {}x{}; {R}x{C} is expected",
                self.rows, self.cols
            ));
        }
        Ok(std::array::from_fn(|r| {
            std::array::from_fn(|c| self.data[r * C + c])
        }))
    }
}

fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(format!(
            "holds {text:?}, which is no number to calculate with"
        )),
    }
}

/// A list or map whose end has not come yet.
enum Open {
    List(Vec<Node>),
    Map(Vec<(String, Node)>, Option<String>),
}

/// The tree of a YAML text of one document. OpenCV's first line, `%YAML:1.0`, has a colon that YAML does not allow; it is read as a comment.
pub(crate) fn node_from_yaml(text: &str) -> Result<Node, String> {
    let readable = if text.starts_with("%YAML:") {
        std::borrow::Cow::Owned(format!("#{text}"))
    } else {
        std::borrow::Cow::Borrowed(text)
    };
    let mut open: Vec<Open> = Vec::new();
    let mut whole = None;
    let mut parser = Parser::new_from_str(&readable);
    let mut events = 0_usize;
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|e| e.to_string())?;
        let at = |reason: &str| format!("{reason} (line {})", span.start.line());
        events += 1;
        if events > 2 * MAX_NODES {
            return Err(at(&format!("more than {MAX_NODES} values")));
        }
        let closed = match event {
            Event::Nothing | Event::StreamStart | Event::DocumentEnd => None,
            Event::DocumentStart(_) if whole.is_some() => {
                return Err(at("a second document begins"));
            }
            Event::DocumentStart(_) => None,
            Event::StreamEnd => break,
            Event::Alias(_) => return Err(at("aliases are not supported")),
            Event::Scalar(text, ..) => Some(Node::Scalar(text.into_owned())),
            Event::SequenceStart(..) => {
                open.push(Open::List(Vec::new()));
                None
            }
            Event::MappingStart(..) => {
                open.push(Open::Map(Vec::new(), None));
                None
            }
            Event::SequenceEnd | Event::MappingEnd => open.pop().map(|o| match o {
                Open::List(items) => Node::List(items),
                Open::Map(entries, _) => Node::Map(entries),
            }),
        };
        if open.len() > MAX_DEPTH {
            return Err(at(&format!("nested deeper than {MAX_DEPTH}")));
        }
        if let Some(node) = closed {
            put(node, &mut open, &mut whole).map_err(|reason| at(&reason))?;
        }
    }
    whole.ok_or_else(|| "it holds no value".to_owned())
}

/// Put a value that is complete into what is open around it.
fn put(node: Node, open: &mut [Open], whole: &mut Option<Node>) -> Result<(), String> {
    if let Node::Map(entries) = &node
        && let Some(key) = twice(entries)
    {
        return Err(format!("the key {key:?} occurs twice"));
    }
    match open.last_mut() {
        None => *whole = Some(node),
        Some(Open::List(items)) => items.push(node),
        Some(Open::Map(entries, key)) => match (key.take(), node) {
            (Some(key), value) => entries.push((key, value)),
            (None, Node::Scalar(text)) => *key = Some(text),
            (None, _) => return Err("a key is a list or a map".to_owned()),
        },
    }
    Ok(())
}

/// A key that occurs more than once.
fn twice(entries: &[(String, Node)]) -> Option<&str> {
    let mut keys: Vec<&str> = entries.iter().map(|(k, _)| k.as_str()).collect();
    keys.sort_unstable();
    keys.windows(2).find(|w| w[0] == w[1]).map(|w| w[0])
}

/// The tree of an XML element as OpenCV writes it: child elements make a map, children called `_` a list, anything else is text.
pub(crate) fn node_from_xml(element: roxmltree::Node<'_, '_>) -> Result<Node, String> {
    fn below(element: roxmltree::Node<'_, '_>, depth: usize) -> Result<Node, String> {
        if depth > MAX_DEPTH {
            return Err(format!("nested deeper than {MAX_DEPTH}"));
        }
        let mut children = element.children().filter(|n| n.is_element()).peekable();
        let Some(first) = children.peek() else {
            return Ok(Node::Scalar(unquoted(element.text().unwrap_or(""))));
        };
        if first.has_tag_name("_") {
            return children
                .map(|n| below(n, depth + 1))
                .collect::<Result<_, _>>()
                .map(Node::List);
        }
        let entries: Vec<(String, Node)> = children
            .map(|n| Ok((n.tag_name().name().to_owned(), below(n, depth + 1)?)))
            .collect::<Result<_, String>>()?;
        match twice(&entries) {
            Some(key) => Err(format!("the element <{key}> occurs twice")),
            None => Ok(Node::Map(entries)),
        }
    }
    below(element, 0)
}

/// OpenCV puts texts that might be taken for something else between quotation marks; those inside are entities.
fn unquoted(text: &str) -> String {
    let text = text.trim();
    text.strip_prefix('"')
        .and_then(|rest| rest.strip_suffix('"'))
        .unwrap_or(text)
        .to_owned()
}
