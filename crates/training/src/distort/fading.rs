//! JPEG 2000 received over a channel that fades, after the distortion "fast fading" of the LIVE database (Sheikh, Sabir
//! and Bovik 2006): a code stream of 2.5 bit per pixel in precincts of 64 x 64 with resynchronisation, sent over a
//! Rayleigh-fading channel; the mean signal-to-noise ratio at the receiver is the strength.
//!
//! Approximation: a packet that is hit is dropped whole, and so are the later layers of its precinct, because their
//! arithmetic codes continue the lost one. A real decoder keeps what came before the error inside the packet and may
//! miss an error. The headers and the coarsest resolution are taken to be protected.

use anyhow::{Context as _, ensure};
use vergence_imaging::Gray;

use crate::distort::jpeg2000::{Coding, RESOLUTIONS, decoded, encoded};
use crate::random::Random;

/// Bits per pixel sent.
const BITS_PER_PIXEL: f64 = 2.5;
/// Side of the precincts, samples.
const PRECINCT: usize = 64;
/// Compression ratios of the layers: each holds twice the bits of the one before.
const LAYER_FACTORS: [f64; 6] = [32.0, 16.0, 8.0, 4.0, 2.0, 1.0];
/// Bits over which the channel stays as it is.
const COHERENCE_BITS: usize = 512;
/// Share of the fading amplitude that is left from one coherence interval to the next.
const CORRELATION: f64 = 0.8;
/// Start of packet, its length and its counter.
const SOP: [u8; 4] = [0xff, 0x91, 0x00, 0x04];
const SOP_BYTES: usize = 6;

/// The picture as it is received at this mean signal-to-noise ratio, dB.
pub fn received(picture: &Gray, snr_db: f64, random: &mut Random) -> anyhow::Result<Gray> {
    let whole = 8.0 / BITS_PER_PIXEL;
    let coding = Coding {
        ratios: LAYER_FACTORS.iter().map(|f| f * whole).collect(),
        precinct: Some(PRECINCT),
    };
    let sent = encoded(picture, &coding)?;
    let precincts = precincts_of(picture.size());
    decoded(&with_losses(&sent, &precincts, snr_db, random)?)
}

/// Number of precincts of each resolution, coarsest first.
fn precincts_of((width, height): (usize, usize)) -> Vec<usize> {
    (0..RESOLUTIONS)
        .rev()
        .map(|level| {
            let across = |n: usize| n.div_ceil(1 << level).div_ceil(PRECINCT);
            across(width) * across(height)
        })
        .collect()
}

/// The code stream with every packet emptied that the channel hit, and those that build on it.
fn with_losses(
    sent: &[u8],
    precincts: &[usize],
    snr_db: f64,
    random: &mut Random,
) -> anyhow::Result<Vec<u8>> {
    let starts = packet_starts(sent);
    let per_layer: usize = precincts.iter().sum();
    ensure!(
        starts.len() == per_layer * LAYER_FACTORS.len(),
        "{} packets where {} were sent",
        starts.len(),
        per_layer * LAYER_FACTORS.len()
    );
    let end = sent.len().saturating_sub(2);
    let mut channel = Channel::new(10f64.powf(snr_db / 10.0), random);
    let mut lost = vec![false; per_layer];
    let mut out = sent[..starts[0]].to_vec();
    for (i, &start) in starts.iter().enumerate() {
        let stop = starts.get(i + 1).copied().unwrap_or(end);
        let hit = channel.hits(8 * (stop - start), random);
        let place = i % per_layer;
        lost[place] |= hit && place >= precincts[0];
        if lost[place] {
            // An empty packet is its marker and one bit 0.
            out.extend_from_slice(&sent[start..start + SOP_BYTES]);
            out.push(0);
        } else {
            out.extend_from_slice(&sent[start..stop]);
        }
    }
    out.extend_from_slice(&sent[end..]);
    let tile = tile_part(&out)?;
    let length = u32::try_from(out.len() - 2 - tile)?;
    out[tile + 6..tile + 10].copy_from_slice(&length.to_be_bytes());
    Ok(out)
}

/// Where the packets begin. The coder never writes FF 91 inside a packet's data.
fn packet_starts(stream: &[u8]) -> Vec<usize> {
    (0..stream.len().saturating_sub(SOP_BYTES))
        .filter(|&i| stream[i..i + 4] == SOP)
        .collect()
}

/// Position of the marker SOT of the only tile part.
fn tile_part(stream: &[u8]) -> anyhow::Result<usize> {
    stream
        .windows(4)
        .position(|w| w == [0xff, 0x90, 0x00, 0x0a])
        .context("a code stream without a tile part")
}

/// A Rayleigh-fading channel: a complex normal amplitude that changes from one coherence interval to the next as an
/// autoregression of first order, and antipodal signalling with error probability erfc(sqrt(snr |h|^2)) / 2.
struct Channel {
    snr: f64,
    amplitude: [f64; 2],
    left_bits: usize,
}

impl Channel {
    fn new(snr: f64, random: &mut Random) -> Self {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        Self {
            snr,
            amplitude: [half * random.normal(), half * random.normal()],
            left_bits: COHERENCE_BITS,
        }
    }

    /// Whether any of the next `bits` is received wrongly.
    fn hits(&mut self, mut bits: usize, random: &mut Random) -> bool {
        let mut log_intact = 0.0;
        while bits > 0 {
            if self.left_bits == 0 {
                let fresh = ((1.0 - CORRELATION * CORRELATION) / 2.0).sqrt();
                for part in &mut self.amplitude {
                    *part = CORRELATION * *part + fresh * random.normal();
                }
                self.left_bits = COHERENCE_BITS;
            }
            let now = bits.min(self.left_bits);
            let power = self.amplitude.iter().map(|a| a * a).sum::<f64>();
            log_intact += now as f64 * (-bit_error(self.snr * power)).ln_1p();
            bits -= now;
            self.left_bits -= now;
        }
        random.unit() > log_intact.exp()
    }
}

/// erfc(sqrt(snr)) / 2 with the approximation of Chiani, Dardari and Simon 2003, erfc(x) = exp(-x^2) / 6 +
/// exp(-4 x^2 / 3) / 2: a third too small at x = 0, close elsewhere; ample for a channel that is itself a model.
fn bit_error(snr: f64) -> f64 {
    0.5 * ((-snr).exp() / 6.0 + (-4.0 / 3.0 * snr).exp() / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At a high ratio nothing is lost and the stream is the one sent; every count of packets agrees with the coder's.
    #[test]
    fn a_good_channel_loses_nothing() {
        let picture = Gray::from_fn(200, 150, |x, y| (x ^ y) as u8);
        let coding = Coding {
            ratios: LAYER_FACTORS.iter().map(|f| f * 3.2).collect(),
            precinct: Some(PRECINCT),
        };
        let sent = encoded(&picture, &coding).unwrap();
        let precincts = precincts_of(picture.size());
        assert_eq!(precincts, [1, 1, 1, 1, 4, 12]);
        let intact = with_losses(&sent, &precincts, 90.0, &mut Random::new(1, 1)).unwrap();
        assert_eq!(intact, sent);
        let torn = with_losses(&sent, &precincts, 10.0, &mut Random::new(1, 1)).unwrap();
        assert!(torn.len() < sent.len() / 2);
        assert_ne!(decoded(&torn).unwrap(), decoded(&sent).unwrap());
    }
}
