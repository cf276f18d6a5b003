//! How a camera describes itself: USB 2.0, chapter 9, and the USB video class 1.1, chapter 3.

use super::camera::{CONTROLS, SIZE, UNITS};

/// The endpoint that sends pictures.
pub(crate) const ENDPOINT: u8 = 0x81;
/// Bytes of a payload at most, its header among them: what the driver asks for at once.
pub(crate) const PAYLOAD: usize = 16_384;
/// Ticks a second of the camera's own clock.
pub(crate) const CLOCK_HZ: u32 = 1_000_000;
/// The numbers of the formats.
pub(crate) const MJPEG: u8 = 1;
pub(crate) const YUYV: u8 = 2;

/// Bytes of a picture that is not compressed.
pub(crate) const RAW_BYTES: usize = 2 * SIZE.0 * SIZE.1;

/// A block that begins with its length.
fn block(body: &[&[u8]]) -> Vec<u8> {
    let body = body.concat();
    [&[body.len() as u8 + 1][..], &body].concat()
}

/// A row of blocks whose first one tells, at this place, how long all of them are.
fn row(mut blocks: Vec<u8>, at: usize) -> Vec<u8> {
    let length = blocks.len() as u16;
    blocks[at..at + 2].copy_from_slice(&length.to_le_bytes());
    blocks
}

pub(crate) fn device() -> Vec<u8> {
    // USB 2.0, many functions in one, 64 bytes, Linux Foundation's numbers; names 1 and 2, no serial number, one configuration.
    let versions = [1, 0, 2, 0xef, 2, 1, 64, 0x6b, 0x1d, 0x02, 0x01, 0, 1];
    block(&[&versions, &[1, 2, 0, 1]])
}

/// Name `index`; 0 is the list of languages (English).
pub(crate) fn string(index: u8, name: &str) -> Option<Vec<u8>> {
    let text = |text: &str| -> Vec<u8> { text.encode_utf16().flat_map(u16::to_le_bytes).collect() };
    Some(match index {
        0 => block(&[&[3, 0x09, 0x04]]),
        1 => block(&[&[3], &text("Vergence")]),
        2 => block(&[&[3], &text(name)]),
        _ => return None,
    })
}

/// A camera that sends these formats, so many pictures a second.
pub(crate) fn configuration(sends: &[u8], fps: u32) -> Vec<u8> {
    let association = block(&[&[0x0b, 0, 2, 0x0e, 3, 0, 0]]);
    let control = block(&[&[4, 0, 0, 0, 0x0e, 1, 0, 0]]);
    let streaming = block(&[&[4, 1, 0, 1, 0x0e, 2, 0, 0]]);
    let endpoint = block(&[&[5, ENDPOINT, 2, 0, 2, 0]]);
    let header = block(&[&[2, 0, 0, 2, 1, 0, 0x80, 250]]);
    let all = [
        header,
        association,
        control,
        topology(),
        streaming,
        formats(sends, fps),
        endpoint,
    ];
    row(all.concat(), 2)
}

/// Camera (1), processing unit (2), output (3).
fn topology() -> Vec<u8> {
    let clock = CLOCK_HZ.to_le_bytes();
    let header = block(&[&[0x24, 1, 0x10, 1, 0, 0], &clock, &[1, 1]]);
    let [camera, processing] = UNITS.map(|unit| {
        let bits = CONTROLS.iter().filter(|c| c.unit == unit).map(|c| c.bit);
        bits.fold(0_u32, |all, bit| all | 1 << bit).to_le_bytes()
    });
    let lens = [0; 6];
    let terminal = block(&[&[0x24, 2, UNITS[0], 1, 2, 0, 0], &lens, &[3], &camera[..3]]);
    let unit = block(&[
        &[0x24, 5, UNITS[1], UNITS[0], 0, 0, 2],
        &processing[..2],
        &[0, 0],
    ]);
    let output = block(&[&[0x24, 3, 3, 1, 1, 0, UNITS[1], 0]]);
    row([header, terminal, unit, output].concat(), 5)
}

fn formats(sends: &[u8], fps: u32) -> Vec<u8> {
    // No still pictures, no trigger; a byte without meaning for each format.
    let count = sends.len() as u8;
    let head = [0x24, 1, count, 0, 0, ENDPOINT, 0, 3, 0, 0, 0, 1];
    let mut all = vec![block(&[&head, &vec![0; sends.len()]])];
    for &format in sends {
        all.push(match format {
            YUYV => uncompressed(),
            _ => block(&[&[0x24, 6, MJPEG, 1, 1, 1, 0, 0, 0, 0]]),
        });
        all.push(frame(if format == YUYV { 5 } else { 7 }, fps));
    }
    all.push(block(&[&[0x24, 13, 1, 1, 4]]));
    row(all.concat(), 4)
}

fn uncompressed() -> Vec<u8> {
    // {32595559-0000-0010-8000-00aa00389b71}, 16 bits a pixel.
    let guid = [
        b'Y', b'U', b'Y', b'2', 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71,
    ];
    block(&[&[0x24, 4, YUYV, 1], &guid, &[16, 1, 0, 0, 0, 0]])
}

/// The only size and rate.
fn frame(kind: u8, fps: u32) -> Vec<u8> {
    let side = |n: usize| (n as u16).to_le_bytes();
    let rate = (8 * RAW_BYTES as u32 * fps).to_le_bytes();
    let period = interval(fps).to_le_bytes();
    block(&[
        &[0x24, kind, 1, 0],
        &side(SIZE.0),
        &side(SIZE.1),
        &rate,
        &rate,
        &(RAW_BYTES as u32).to_le_bytes(),
        &period,
        &[1],
        &period,
    ])
}

/// From picture to picture, units of 100 ns.
fn interval(fps: u32) -> u32 {
    10_000_000 / fps
}

/// What is agreed on before pictures are sent (table 4-47): the format is the host's choice, the rest ours.
pub(crate) fn agreement(format: u8, fps: u32) -> Vec<u8> {
    let mut all = vec![0; 34];
    all[2] = if format == YUYV { YUYV } else { MJPEG };
    all[3] = 1;
    all[4..8].copy_from_slice(&interval(fps).to_le_bytes());
    all[18..22].copy_from_slice(&(RAW_BYTES as u32).to_le_bytes());
    all[22..26].copy_from_slice(&(PAYLOAD as u32).to_le_bytes());
    all[26..30].copy_from_slice(&CLOCK_HZ.to_le_bytes());
    all
}
