//! Picture files that say themselves how they hold two eyes.
//!
//! - **MPO**: whole JPEG pictures one behind the other, with an index (CIPA DC-007-2009, "Multi-Picture Format"). Of the type
//!   *disparity* are the views of a stereo picture; their numbers count from the left.
//! - **JPS**: a JPEG picture with both eyes in it and a descriptor in APP3 (VRex 1997, "General Purpose Stereoscopic Data Descriptor").
//!   Without its flag "left field first" the right eye's picture is on the left, for viewing with crossed eyes.
//! - **Stim**: the same after CIPA DC-006-2008.
//! - **PNG** with the chunk `sTER` (PNG extensions 1.2.0).

use std::ops::Range;

use crate::tags::{Segment, Tiff, chunks_of_png, segments_of_jpeg};

/// Which eye has the left or the upper half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The left eye; of halves beside each other this is for parallel viewing.
    LeftFirst,
    /// The right eye; of halves beside each other this is for viewing with crossed eyes.
    RightFirst,
}

/// How two eyes share one picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packing {
    /// The halves lie beside or above each other.
    pub halves: Halves,
    /// Whose half is first.
    pub order: Order,
    /// Each half is squeezed to half its width (beside each other) or height (above each other).
    pub squeezed: bool,
    /// Pixels between the halves that belong to neither.
    pub gap_px: usize,
}

/// Where the halves of a picture lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Halves {
    /// Beside each other.
    SideBySide,
    /// Above each other.
    OverUnder,
}

/// What a file says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StereoTag {
    /// The two eyes are pictures of their own, at these bytes of the file.
    Separate {
        /// The left eye's file.
        left: Range<usize>,
        /// The right eye's file.
        right: Range<usize>,
        /// How many views there are; the first two are taken.
        views: usize,
    },
    /// The two eyes share the picture.
    Packed(Packing),
    /// One picture for one or both eyes.
    Mono,
    /// Two eyes in a way that is not read; in words, "rows of both eyes interleaved".
    NotRead(&'static str),
}

/// A tag and where it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// What it says.
    pub tag: StereoTag,
    /// Which tag it is, for people: "index of pictures (MPF)".
    pub place: &'static str,
}

/// What the file says about its two eyes; `None` where it says nothing.
///
/// # Errors
/// One clause, where the file contradicts itself: an index that points beyond the file's end, a descriptor with unknown codes.
pub fn stereo_tag(bytes: &[u8]) -> Result<Option<Found>, String> {
    let found = |place| move |tag| Found { tag, place };
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Ok(png_tag(bytes)?.map(found("chunk sTER")));
    }
    for segment in segments_of_jpeg(bytes) {
        let tag = match segment.mark {
            0xe2 if segment.body.starts_with(b"MPF\0") => {
                mpf_tag(bytes, segment)?.map(found("index of pictures (MPF)"))
            }
            0xe3 => app3_tag(segment.body)?.map(|(tag, place)| found(place)(tag)),
            0xe1 if hides_a_picture(segment.body) => Some(found("XMP data")(StereoTag::NotRead(
                "the right eye's picture as text in XMP data (VR180)",
            ))),
            _ => None,
        };
        if tag.is_some() {
            return Ok(tag);
        }
    }
    Ok(None)
}

/// Type codes of the pictures of an MPO file (DC-007, table 4).
const MP_DISPARITY: u32 = 0x02_0002;
const MP_PRIMARY: u32 = 0x03_0000;
const MP_UNDEFINED: u32 = 0;

/// Most pictures of one file that are looked at.
const MAX_VIEWS: usize = 64;

/// An entry of the index of an MPO file.
struct MpEntry {
    kind: u32,
    bytes: Range<usize>,
}

fn mpf_tag(bytes: &[u8], segment: Segment<'_>) -> Result<Option<StereoTag>, String> {
    let base = segment.at + 4;
    let Some(entries) = Tiff::new(&segment.body[4..]).and_then(|tiff| mp_entries(&tiff, base))
    else {
        return Ok(None);
    };
    let sizes = |e: &MpEntry| {
        let picture = bytes.get(e.bytes.clone());
        picture.and_then(|b| crate::jpeg::size_from_jpeg(b).ok())
    };
    let views: Vec<&MpEntry> = entries
        .iter()
        .filter(|e| matches!(e.kind, MP_DISPARITY | MP_PRIMARY))
        .collect();
    // Some writers leave the type out; two equal sizes are two eyes, a small second picture is something else.
    let untyped = entries.len() == 2
        && entries
            .iter()
            .all(|e| matches!(e.kind, MP_UNDEFINED | MP_PRIMARY))
        && sizes(&entries[0]).is_some()
        && sizes(&entries[0]) == sizes(&entries[1]);
    let disparity = views.iter().any(|e| e.kind == MP_DISPARITY) && views.len() >= 2;
    let mut views = match (disparity, untyped) {
        (true, _) => views,
        (false, true) => entries.iter().collect(),
        (false, false) => return Ok(None),
    };
    for (i, view) in views.iter().enumerate() {
        if bytes.get(view.bytes.clone()).is_none() {
            return Err(format!(
                "its index has picture {} at bytes {} to {}, but the file ends after {}",
                i + 1,
                view.bytes.start,
                view.bytes.end,
                bytes.len()
            ));
        }
    }
    // Numbers count from the left; without them the order in the file does.
    let number = |e: &MpEntry| mp_number(&bytes[e.bytes.clone()]);
    if views.iter().all(|e| number(e).is_some()) {
        views.sort_by_key(|e| number(e));
    }
    Ok(Some(StereoTag::Separate {
        left: views[0].bytes.clone(),
        right: views[1].bytes.clone(),
        views: views.len(),
    }))
}

/// The index: tag 0xb002, 16 bytes a picture (attribute, size, offset from the TIFF header, two dependants).
fn mp_entries(tiff: &Tiff<'_>, base: usize) -> Option<Vec<MpEntry>> {
    let index = tiff.directories().next()?;
    let list = index.iter().find(|e| e.tag == 0xb002)?;
    let count = (list.count as usize / 16).min(MAX_VIEWS);
    let entry = |i: usize| {
        let at = list.value as usize + 16 * i;
        let size = tiff.u32_at(at + 4)? as usize;
        // The first picture's offset is 0: it begins with the file.
        let start = match tiff.u32_at(at + 8)? as usize {
            0 => 0,
            offset => base + offset,
        };
        Some(MpEntry {
            kind: tiff.u32_at(at)? & 0xff_ffff,
            bytes: start..start + size,
        })
    };
    (0..count).map(entry).collect()
}

/// The number of a view (tag 0xb101) in its own segment MPF.
fn mp_number(picture: &[u8]) -> Option<u32> {
    let segment =
        segments_of_jpeg(picture).find(|s| s.mark == 0xe2 && s.body.starts_with(b"MPF\0"))?;
    let tiff = Tiff::new(&segment.body[4..])?;
    let number = tiff.directories().flatten().find(|e| e.tag == 0xb101)?;
    (number.value != u32::MAX).then_some(number.value)
}

type Placed = (StereoTag, &'static str);

fn app3_tag(body: &[u8]) -> Result<Option<Placed>, String> {
    if let Some(rest) = body.strip_prefix(b"_JPSJPS_") {
        return jps_tag(rest).map(|tag| Some((tag, "stereoscopic descriptor (APP3, JPS)")));
    }
    if let Some(rest) = body.strip_prefix(b"Stim\0") {
        return Ok(stim_tag(rest).map(|tag| (tag, "stereo segment (APP3, CIPA DC-006)")));
    }
    Ok(None)
}

/// Length, then separation, flags, layout and type of the descriptor, a byte each.
fn jps_tag(rest: &[u8]) -> Result<StereoTag, String> {
    let &[gap, flags, layout, kind] = rest
        .get(2..6)
        .ok_or("its stereoscopic descriptor breaks off")?
    else {
        return Err("its stereoscopic descriptor breaks off".to_owned());
    };
    let packed = |halves, squeezed_by: u8| {
        StereoTag::Packed(Packing {
            halves,
            order: if flags & 4 != 0 {
                Order::LeftFirst
            } else {
                Order::RightFirst
            },
            squeezed: flags & squeezed_by != 0,
            gap_px: usize::from(gap),
        })
    };
    Ok(match (kind, layout) {
        (0, _) => StereoTag::Mono,
        (1, 1) => StereoTag::NotRead("rows of both eyes interleaved"),
        (1, 2) => packed(Halves::SideBySide, 2),
        (1, 3) => packed(Halves::OverUnder, 1),
        (1, 4) => StereoTag::NotRead("both eyes as an anaglyph"),
        _ => {
            return Err(format!(
                "its stereoscopic descriptor has the unknown type {kind} and layout {layout}"
            ));
        }
    })
}

/// Tag 2 of the segment: 0 for parallel, 1 for crossed viewing.
fn stim_tag(rest: &[u8]) -> Option<StereoTag> {
    // A filling byte stands before the TIFF structure in some files.
    let tiff = Tiff::new(rest).or_else(|| Tiff::new(rest.get(1..)?))?;
    let arrangement = tiff.directories().flatten().find(|e| e.tag == 2)?;
    let order = match arrangement.value {
        0 => Order::LeftFirst,
        1 => Order::RightFirst,
        _ => return None,
    };
    Some(StereoTag::Packed(Packing {
        halves: Halves::SideBySide,
        order,
        squeezed: false,
        gap_px: 0,
    }))
}

/// The chunk `sTER`: 0 for crossed, 1 for parallel viewing. Each half begins at a multiple of 8 columns.
fn png_tag(bytes: &[u8]) -> Result<Option<StereoTag>, String> {
    let mut width = None;
    for (name, body) in chunks_of_png(bytes) {
        match &name {
            b"IHDR" => width = body.first_chunk().map(|w| u32::from_be_bytes(*w)),
            b"sTER" => {
                let (Some(width), Some(mode)) = (width.filter(|w| *w > 0), body.first()) else {
                    return Err("its chunk sTER is empty or comes before the size".to_owned());
                };
                let gap_px = 15 - (width - 1) % 16;
                if gap_px > 7 || *mode > 1 {
                    return Err(format!(
                        "its chunk sTER does not fit: mode {mode}, {width} columns"
                    ));
                }
                return Ok(Some(StereoTag::Packed(Packing {
                    halves: Halves::SideBySide,
                    order: if *mode == 1 {
                        Order::LeftFirst
                    } else {
                        Order::RightFirst
                    },
                    squeezed: false,
                    gap_px: gap_px as usize,
                })));
            }
            b"IDAT" => break,
            _ => {}
        }
    }
    Ok(None)
}

fn hides_a_picture(body: &[u8]) -> bool {
    const MIME: &[u8] = b"GImage:Mime";
    body.starts_with(b"http://ns.adobe.com/xap/") && body.windows(MIME.len()).any(|w| w == MIME)
}

#[cfg(test)]
mod tests;
