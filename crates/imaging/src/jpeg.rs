//! JPEG files, decoded only when nothing of them is missing.
//!
//! Decoders made for browsers fill what a broken file has lost with grey and say nothing; a measurement needs to know. So the
//! decoder runs in its strict mode, and before it the compressed data are counted: a baseline picture must hold exactly the
//! blocks that its size asks for, its restart marks in order, and the mark of its end ([`check`]). Of a progressive picture only
//! the marks are followed; there the decoder's own strictness has to do.
//!
//! Layout and Huffman decoding after ITU-T T.81 (1992), annexes B, C and F. A change that leaves a stream of valid codes with the
//! right number of blocks cannot be seen: JPEG has no checksum.

use std::borrow::Cow;
use std::sync::OnceLock;

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::files::MAX_SIDE;
use crate::plane::Rgb;

/// Most bytes between the last block of a scan and the mark after it: some encoders fill up to a word.
const MAX_PADDING: usize = 8;

/// Every JPEG file begins with these bytes.
pub(crate) const START: [u8; 3] = [0xff, 0xd8, 0xff];

/// What is said of a file for a press. Files disagree about whether 0 is no ink or full ink, and what the inks look like is said by
/// profiles that are not read.
pub(crate) const PRINT_COLOURS: &str =
    "its colours are CMYK, for printing; convert it to RGB and read that";

/// The mark of the end.
const END: [u8; 2] = [0xff, 0xd9];

const BROKEN_OFF: &str = "its data break off";

/// The picture, or what is wrong with the file.
pub(crate) fn rgb_from_jpeg(bytes: &[u8]) -> Result<Rgb, String> {
    check(bytes)?;
    decoded(bytes)
}

/// The picture of a frame of motion JPEG, which need not have the mark of its end: some cameras leave it out, or fill up what they send. All of its blocks
/// must be there and be counted.
pub(crate) fn rgb_from_frame(bytes: &[u8]) -> Result<Rgb, String> {
    let Err(why) = check(bytes) else {
        return decoded(bytes);
    };
    let ended = with_end(bytes);
    match check(&ended) {
        Ok(Counted::All) => decoded(&ended),
        _ => Err(why),
    }
}

/// A frame without what fills it up, and with the mark of its end. Zeros that fill up would be read as blocks, and stand in for those that a cut has taken:
/// one is left, since the last byte of the data may be zero.
fn with_end(bytes: &[u8]) -> Vec<u8> {
    let mut data = bytes.strip_suffix(&END).unwrap_or(bytes);
    while let Some(shorter) = data.strip_suffix(&[0xff]) {
        data = shorter;
    }
    while data.ends_with(&[0, 0]) {
        data = &data[..data.len() - 1];
    }
    [data, &END].concat()
}

fn decoded(bytes: &[u8]) -> Result<Rgb, String> {
    let mut decoder = decoder(bytes);
    decoder.decode_headers().map_err(|e| e.to_string())?;
    if let Some(ColorSpace::CMYK | ColorSpace::YCCK) = decoder.input_colorspace() {
        return Err(PRINT_COLOURS.to_owned());
    }
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let colours = if grey {
        ColorSpace::Luma
    } else {
        ColorSpace::RGB
    };
    decoder.set_options(options().jpeg_set_out_colorspace(colours));
    let samples = decoder.decode().map_err(|e| e.to_string())?;
    let (w, h) = decoder.dimensions().ok_or("it has no size")?;
    let pixels: Vec<[u8; 3]> = if grey {
        samples.into_iter().map(|v| [v; 3]).collect()
    } else {
        samples.as_chunks().0.to_vec()
    };
    if pixels.len() != w * h {
        return Err(format!("{} pixels came out of {w} x {h}", pixels.len()));
    }
    Ok(Rgb::from_samples(w, h, pixels))
}

/// A frame of motion JPEG with the usual Huffman tables before its first scan, if it brings none.
pub(crate) fn with_tables(bytes: &[u8]) -> Cow<'_, [u8]> {
    let Some(scan) = start_of_scan(bytes) else {
        return Cow::Borrowed(bytes);
    };
    let mut whole = bytes[..scan].to_vec();
    whole.extend_from_slice(usual_tables());
    whole.extend_from_slice(&bytes[scan..]);
    Cow::Owned(whole)
}

/// Where the first scan begins in a file without Huffman tables; `None` in one that has some, or that makes no sense.
fn start_of_scan(bytes: &[u8]) -> Option<usize> {
    let mut rest = bytes.get(2..)?;
    loop {
        let at = bytes.len() - rest.len();
        let (mark, after) = next_mark(rest).ok()?;
        match mark {
            0xda => return Some(at),
            0xc4 | 0xd8..=0xd9 => return None,
            _ => {}
        }
        let length = usize::from(u16_at(after, 0).ok()?);
        rest = after.get(length..)?;
    }
}

/// The segments of the tables of annex K, which the encoder writes.
fn usual_tables() -> &'static [u8] {
    static TABLES: OnceLock<Vec<u8>> = OnceLock::new();
    TABLES.get_or_init(|| {
        let small = Rgb::filled(16, 16, [10, 200, 90]);
        let bytes = crate::files::encode_jpeg(&small, 90).unwrap_or_default();
        let mut tables = Vec::new();
        let mut rest = bytes.get(2..).unwrap_or_default();
        while let Ok((mark, after)) = next_mark(rest) {
            let length = usize::from(u16_at(after, 0).unwrap_or(0));
            let Some(body) = after.get(..length).filter(|_| mark != 0xda) else {
                break;
            };
            if mark == 0xc4 {
                tables.extend_from_slice(&[0xff, mark]);
                tables.extend_from_slice(body);
            }
            rest = &after[length..];
        }
        tables
    })
}

/// Width and height by the header.
pub(crate) fn size_from_jpeg(bytes: &[u8]) -> Result<(usize, usize), String> {
    // Any size that a header can give: whoever asks says what is too large, with the figures.
    let most = usize::from(u16::MAX);
    let options = options().set_max_width(most).set_max_height(most);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|e| e.to_string())?;
    decoder
        .dimensions()
        .ok_or_else(|| "it has no size".to_owned())
}

fn decoder(bytes: &[u8]) -> JpegDecoder<ZCursor<&[u8]>> {
    JpegDecoder::new_with_options(ZCursor::new(bytes), options())
}

fn options() -> DecoderOptions {
    DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
}

/// Which blocks of a whole file were counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Counted {
    All,
    /// Not those of each component: of a progressive picture none.
    Some,
}

/// Whether a file is whole; see the module.
pub(crate) fn check(bytes: &[u8]) -> Result<Counted, String> {
    let mut file = File::default();
    let mut components = 0;
    let mut rest = bytes.get(2..).ok_or(BROKEN_OFF)?;
    let mut scans = 0;
    loop {
        let (mark, after) = next_mark(rest)?;
        // T.81, table B.1.
        match mark {
            0xd9 if scans > 0 => {
                let wanted = file.frame.as_ref().map(|frame| frame.components.len());
                let all = wanted.is_some_and(|wanted| components == wanted);
                return Ok(if all { Counted::All } else { Counted::Some });
            }
            0xd9 => return Err("it ends before its first scan".to_owned()),
            0x01 | 0xd0..=0xd8 => {
                rest = after;
                continue;
            }
            _ => {}
        }
        let length = usize::from(u16_at(after, 0)?);
        let body = after.get(2..length).ok_or(BROKEN_OFF)?;
        rest = &after[length..];
        match mark {
            0xc4 => file.take_tables(body)?,
            0xc0 | 0xc1 => file.frame = Frame::from_body(body)?,
            0xc2..=0xcf => file.frame = None,
            0xdd => file.restart_every = usize::from(u16_at(body, 0)?),
            0xda => {
                scans += 1;
                rest = match file.scan(body)? {
                    Some(scan) => {
                        components += scan.components;
                        scan.after(rest)?
                    }
                    None => after_data(rest),
                };
            }
            _ => {}
        }
    }
}

fn u16_at(bytes: &[u8], at: usize) -> Result<u16, String> {
    let two = bytes.get(at..at + 2).ok_or(BROKEN_OFF)?;
    Ok(u16::from_be_bytes([two[0], two[1]]))
}

/// The mark at the beginning and what follows it.
fn next_mark(bytes: &[u8]) -> Result<(u8, &[u8]), String> {
    let fill = bytes.iter().take_while(|b| **b == 0xff).count();
    match bytes.get(fill) {
        None => Err(BROKEN_OFF.to_owned()),
        Some(_) if fill == 0 => Err("its data are garbled".to_owned()),
        Some(&mark) => Ok((mark, &bytes[fill + 1..])),
    }
}

/// From the mark that ends compressed data on; restart marks do not.
fn after_data(bytes: &[u8]) -> &[u8] {
    let ends = |two: &[u8]| two[0] == 0xff && !matches!(two[1], 0x00 | 0xd0..=0xd7 | 0xff);
    let at = bytes.windows(2).position(ends).unwrap_or(bytes.len());
    &bytes[at..]
}

/// What the headers said so far.
#[derive(Default)]
struct File {
    /// By class (DC, AC) and number.
    tables: [[Option<Box<Table>>; 4]; 2],
    /// `None` for pictures whose blocks are not counted.
    frame: Option<Frame>,
    restart_every: usize,
}

struct Frame {
    size: (usize, usize),
    /// Number, blocks across and blocks down in a unit.
    components: Vec<(u8, usize, usize)>,
}

/// Length and symbol of the code with which 16 bits begin; length 0 where no code does.
struct Table(Vec<(u8, u8)>);

struct Scan<'a> {
    /// The DC and the AC table of each block of a unit.
    blocks: Vec<[&'a Table; 2]>,
    components: usize,
    units: usize,
    restart_every: usize,
}

impl Frame {
    /// From the body of a frame header; `None` when a sample does not have 8 bits.
    fn from_body(body: &[u8]) -> Result<Option<Self>, String> {
        let (h, w) = (u16_at(body, 1)?, u16_at(body, 3)?);
        let count = usize::from(*body.get(5).ok_or(BROKEN_OFF)?);
        let mut components = Vec::new();
        for part in body[6..].as_chunks::<3>().0.iter().take(count) {
            let (across, down) = (usize::from(part[1] >> 4), usize::from(part[1] & 15));
            if !(1..=4).contains(&across) || !(1..=4).contains(&down) {
                return Err("its header is garbled".to_owned());
            }
            components.push((part[0], across, down));
        }
        if components.is_empty() || components.len() != count {
            return Err("its header is garbled".to_owned());
        }
        Ok((body[0] == 8).then_some(Self {
            size: (usize::from(w), usize::from(h)),
            components,
        }))
    }

    /// Units of a scan of these components (T.81, A.2).
    fn units(&self, inside: &[usize]) -> usize {
        let most = |f: fn(&(u8, usize, usize)) -> usize| self.components.iter().map(f).max();
        let (across, down) = (most(|c| c.1).unwrap_or(1), most(|c| c.2).unwrap_or(1));
        let (w, h) = self.size;
        match inside {
            [one] => {
                let (_, a, d) = self.components[*one];
                (w * a).div_ceil(across).div_ceil(8) * (h * d).div_ceil(down).div_ceil(8)
            }
            _ => w.div_ceil(8 * across) * h.div_ceil(8 * down),
        }
    }
}

impl Table {
    /// From how many codes there are of each length, and their symbols (T.81, C.2).
    fn new(counts: &[u8; 16], symbols: &[u8]) -> Result<Self, String> {
        let mut codes = Vec::with_capacity(1 << 16);
        let mut symbols = symbols.iter();
        for (bits, count) in (1_u8..).zip(counts) {
            for symbol in symbols.by_ref().take(usize::from(*count)) {
                let filled = codes.len() + (1 << (16 - bits));
                if filled > 1 << 16 {
                    return Err("a code table is garbled".to_owned());
                }
                codes.resize(filled, (bits, *symbol));
            }
        }
        codes.resize(1 << 16, (0, 0));
        Ok(Self(codes))
    }
}

impl File {
    fn take_tables(&mut self, mut body: &[u8]) -> Result<(), String> {
        while let Some((&place, after)) = body.split_first() {
            let counts: &[u8; 16] = after.first_chunk().ok_or(BROKEN_OFF)?;
            let codes = counts.iter().map(|n| usize::from(*n)).sum::<usize>();
            let symbols = after.get(16..16 + codes).ok_or(BROKEN_OFF)?;
            let (class, number) = (usize::from(place >> 4), usize::from(place & 15));
            let slot = self
                .tables
                .get_mut(class)
                .and_then(|of_class| of_class.get_mut(number))
                .ok_or("a code table is garbled")?;
            *slot = Some(Box::new(Table::new(counts, symbols)?));
            body = &after[16 + codes..];
        }
        Ok(())
    }

    /// What a scan must hold; `None` where that is not counted: progressive pictures, and those of video streams that leave
    /// the usual tables out.
    fn scan(&self, body: &[u8]) -> Result<Option<Scan<'_>>, String> {
        let Some(frame) = &self.frame else {
            return Ok(None);
        };
        let count = usize::from(*body.first().ok_or(BROKEN_OFF)?);
        let parts = body
            .get(1..1 + 2 * count)
            .ok_or(BROKEN_OFF)?
            .as_chunks::<2>();
        let (mut inside, mut blocks) = (Vec::new(), Vec::new());
        for [number, places] in parts.0 {
            let at = frame.components.iter().position(|c| c.0 == *number);
            let at = at.ok_or("its scan header is garbled")?;
            let table = |class: usize, number: u8| {
                let slot = self.tables[class].get(usize::from(number));
                slot.and_then(Option::as_deref)
            };
            let (Some(dc), Some(ac)) = (table(0, places >> 4), table(1, places & 15)) else {
                return Ok(None);
            };
            let (_, across, down) = frame.components[at];
            let of_unit = if count == 1 { 1 } else { across * down };
            blocks.extend(std::iter::repeat_n([dc, ac], of_unit));
            inside.push(at);
        }
        Ok(Some(Scan {
            components: inside.len(),
            units: frame.units(&inside),
            blocks,
            restart_every: self.restart_every,
        }))
    }
}

impl Scan<'_> {
    /// Follow the compressed data to their end; what comes after them, from the next mark on.
    fn after<'a>(&self, data: &'a [u8]) -> Result<&'a [u8], String> {
        let mut bits = Bits::new(data);
        for unit in 0..self.units {
            if self.restart_every > 0 && unit > 0 && unit % self.restart_every == 0 {
                let number = (unit / self.restart_every - 1) % 8;
                bits = bits.restarted(0xd0 + number as u8)?;
            }
            for [dc, ac] in &self.blocks {
                bits.pass_block(dc, ac).ok_or_else(|| {
                    let state = if bits.ended {
                        "break off"
                    } else {
                        "are garbled"
                    };
                    format!("its data {state} after {unit} of {} units", self.units)
                })?;
            }
        }
        let rest = bits.rest();
        let end = after_data(rest);
        if rest.len() - end.len() > MAX_PADDING {
            return Err(format!(
                "its data are garbled: {} bytes are left over",
                rest.len() - end.len()
            ));
        }
        Ok(end)
    }
}

/// Bits of compressed data, up to the next mark.
struct Bits<'a> {
    data: &'a [u8],
    /// Next byte to take.
    at: usize,
    /// The next bits, left-aligned, ones behind them.
    next: u64,
    count: u32,
    /// A mark or the end has been met.
    ended: bool,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self {
            data,
            at: 0,
            next: 0,
            count: 0,
            ended: false,
        }
    }

    /// One block: its constant part, then up to 63 others (T.81, F.2.2). `None` where no code fits.
    fn pass_block(&mut self, dc: &Table, ac: &Table) -> Option<()> {
        let bits = self.code(dc)?;
        self.pass(u32::from(bits & 15))?;
        let mut k = 1;
        while k < 64 {
            let symbol = self.code(ac)?;
            let (zeros, bits) = (symbol >> 4, symbol & 15);
            if bits == 0 && zeros != 15 {
                break;
            }
            k += u32::from(zeros) + 1;
            if k > 64 {
                return None;
            }
            self.pass(u32::from(bits))?;
        }
        Some(())
    }

    fn code(&mut self, table: &Table) -> Option<u8> {
        if self.count < 32 {
            self.refill();
        }
        let (bits, symbol) = table.0[(self.next >> 48) as usize];
        if bits == 0 {
            return None;
        }
        self.pass(u32::from(bits))?;
        Some(symbol)
    }

    /// `None` when there are not that many bits; at most 16 are asked for after each code.
    fn pass(&mut self, bits: u32) -> Option<()> {
        self.count = self.count.checked_sub(bits)?;
        self.next <<= bits;
        Some(())
    }

    fn refill(&mut self) {
        while self.count <= 48 && !self.ended {
            let byte = self.data.get(self.at).copied();
            let stuffed = self.data.get(self.at + 1) == Some(&0);
            match byte {
                Some(0xff) if stuffed => self.at += 2,
                Some(byte) if byte != 0xff => self.at += 1,
                _ => {
                    self.ended = true;
                    return;
                }
            }
            self.next |= u64::from(byte.unwrap_or(0xff)) << (56 - self.count);
            self.count += 8;
        }
    }

    /// What was not taken, without the bits that fill the last byte.
    fn rest(&self) -> &'a [u8] {
        let mut back = self.count / 8;
        let mut at = self.at;
        while back > 0 {
            // A stuffed byte is two.
            at -= if at >= 2 && self.data[at - 2..at] == [0xff, 0] {
                2
            } else {
                1
            };
            back -= 1;
        }
        &self.data[at..]
    }

    /// Past the restart mark that must come now.
    fn restarted(self, wanted: u8) -> Result<Self, String> {
        let rest = self.rest();
        let at = rest.iter().take(MAX_PADDING).position(|b| *b == 0xff);
        let (mark, after) = next_mark(rest.get(at.unwrap_or(0)..).unwrap_or(&[]))?;
        if mark != wanted {
            return Err("its data are garbled: a restart mark is missing".to_owned());
        }
        Ok(Self::new(after))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::jpeg_from_rgb;

    fn picture() -> Rgb {
        let mut state = 1_u32;
        Rgb::from_fn(203, 117, |x, y| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            std::array::from_fn(|c| (x * (c + 1) + y / (c + 1)) as u8 ^ (state >> 27) as u8)
        })
    }

    /// Whole files pass, padded ones and such with bytes after their end as well, and come out with the right size and nearly the right
    /// colours; a grey file gives equal channels.
    #[test]
    fn whole_files_pass() {
        let mut bytes = jpeg_from_rgb(&picture()).unwrap();
        let got = rgb_from_jpeg(&bytes).unwrap();
        assert_eq!(got.size(), (203, 117));
        let end = bytes.len() - 2;
        bytes.splice(end..end, [0xff, 0xff, 0xff]);
        bytes.extend([1, 2, 3]);
        assert_eq!(rgb_from_jpeg(&bytes).unwrap(), got);
        assert_eq!(size_from_jpeg(&bytes).unwrap(), (203, 117));
    }

    /// Frames without Huffman tables, as cameras send them, give the same picture as with them; frames that bring some stay as they are.
    #[test]
    fn frames_without_tables() {
        let bytes = jpeg_from_rgb(&picture()).unwrap();
        let mut bare = bytes[..2].to_vec();
        let mut rest = &bytes[2..];
        let mut taken = 0;
        loop {
            let (mark, after) = next_mark(rest).unwrap();
            let length = usize::from(u16_at(after, 0).unwrap());
            if mark == 0xda {
                bare.extend_from_slice(rest);
                break;
            }
            if mark == 0xc4 {
                taken += 1;
            } else {
                bare.extend_from_slice(&[0xff, mark]);
                bare.extend_from_slice(&after[..length]);
            }
            rest = &after[length..];
        }
        assert!(taken > 0 && bare.len() + 400 < bytes.len());
        assert!(rgb_from_jpeg(&bare).is_err());
        let whole = crate::files::rgb_from_motion_jpeg(&bytes, None).unwrap();
        assert_eq!(
            crate::files::rgb_from_motion_jpeg(&bare, None).unwrap(),
            whole
        );
        assert_eq!(whole, rgb_from_jpeg(&bytes).unwrap());
        for length in 0..bare.len() - 2 {
            assert!(crate::files::rgb_from_motion_jpeg(&bare[..length], None).is_err());
        }
    }

    /// A frame without the mark of its end, filled up or not, gives the same picture; one that lacks more is refused, filled up or not.
    #[test]
    fn frames_without_an_end() {
        let frame = |bytes: &[u8]| crate::files::rgb_from_motion_jpeg(bytes, None);
        let bytes = jpeg_from_rgb(&picture()).unwrap();
        let whole = frame(&bytes).unwrap();
        let bare = &bytes[..bytes.len() - 2];
        for fill in [0, 0xff] {
            for count in [0, 1, 2, 7, 500, 40_000] {
                let filled = [bare, &vec![fill; count]].concat();
                assert_eq!(frame(&filled).unwrap(), whole, "{count} of {fill}");
                assert!(rgb_from_jpeg(&filled).is_err());
                let ended = [&filled[..], &END].concat();
                assert_eq!(frame(&ended).unwrap(), whole, "{count} of {fill}");
            }
        }
        for length in (0..bare.len())
            .rev()
            .step_by(7)
            .chain(bare.len() - 20..bare.len())
        {
            assert!(frame(&bare[..length]).is_err(), "{length}");
            assert!(
                frame(&[&bare[..length], &[0xff; 300]].concat()).is_err(),
                "{length}"
            );
        }
        for length in (0..bare.len() - 60).rev().step_by(101) {
            assert!(
                frame(&[&bare[..length], &[0; 40_000]].concat()).is_err(),
                "{length}"
            );
        }
    }

    /// Every prefix of a file is refused, one byte short as well as a thousand.
    #[test]
    fn no_prefix_passes() {
        let bytes = jpeg_from_rgb(&picture()).unwrap();
        for length in 0..bytes.len() {
            assert!(check(&bytes[..length]).is_err(), "{length} bytes");
        }
    }

    /// Lost and random bytes in the compressed data: nearly all are seen (a stream of valid codes with the right number of blocks
    /// is a valid file, whatever it shows), and nothing panics.
    #[test]
    fn garbled_data_are_seen() {
        let bytes = jpeg_from_rgb(&picture()).unwrap();
        let header = bytes.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 14;
        let mut state = 7_u32;
        let mut draw = |below: usize| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as usize % below
        };
        let mut seen = [0; 2];
        for _ in 0..200 {
            let at = header + draw(bytes.len() - header - 600);
            let mut lost = bytes.clone();
            lost.drain(at..at + 500);
            seen[0] += usize::from(check(&lost).is_err());
            let mut random = bytes.clone();
            random[at..at + 500].fill_with(|| draw(256) as u8);
            seen[1] += usize::from(check(&random).is_err());
            let _ = rgb_from_jpeg(&random);
        }
        assert!(seen[0] >= 198 && seen[1] >= 190, "{seen:?} of 200");
    }
}
