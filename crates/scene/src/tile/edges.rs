//! Pixels at which the surface changes, taken with several rays.

use std::ops::Range;

use super::{Instant, MARK_SAMPLES, Place, RayTable, Surroundings, TILE, Workspace};
use crate::kernels;
use crate::reference::FIRST_CARD;
use crate::view::View;

/// Width of the strips in which pixels on edges are listed.
const STRIP: usize = 8;

impl Workspace {
    pub(super) fn find_edges(&mut self, width: usize, height: usize) {
        let edge = &mut self.edge[..width * height];
        kernels::edges(&self.id, width, edge);
        if !self.cards.is_empty() {
            // What is printed on a mark needs as much care as its outline.
            for y in 0..height {
                for x in 0..width {
                    let id = self.id[(y + 1) * (width + 2) + x + 1];
                    edge[y * width + x] |= u32::from(id >= u32::from(FIRST_CARD));
                }
            }
        }
        // Column by column of strips: the rays of neighbours in the list then lie close together, and few things meet their bounds.
        self.edge_list.clear();
        for strip in (0..width).step_by(STRIP) {
            for y in 0..height {
                let from = y * width + strip;
                let row = &edge[from..y * width + width.min(strip + STRIP)];
                // Most rows of a strip have none, which takes one look.
                if row.iter().fold(0, |any, e| any | e) == 0 {
                    continue;
                }
                let pixels = row.iter().enumerate().filter(|(_, e)| **e != 0);
                self.edge_list
                    .extend(pixels.map(|(x, _)| (from + x) as u32));
            }
        }
    }

    pub(super) fn smooth_edges(
        &mut self,
        view: &View,
        place: &Place,
        rays: &RayTable,
        around: &Surroundings,
        instant: Instant,
        out: &mut [Vec<f32>; 3],
    ) {
        // Every instant of an exposure takes its share of the samples, at other places in the pixel.
        let all = if self.cards.is_empty() {
            around.edge_samples
        } else {
            MARK_SAMPLES
        };
        let count = (all / instant.count).max(2);
        let offsets: Vec<[f32; 2]> = (0..count)
            .map(|s| net(instant.index + s * instant.count, count * instant.count))
            .collect();
        let count = offsets.len();
        let shaded = std::mem::take(&mut self.shaded);
        let list = std::mem::take(&mut self.edge_list);
        for pixels in list.chunks(TILE[0] * TILE[1] / count) {
            for (k, &i) in pixels.iter().enumerate() {
                let (x, y) = (i as usize % place.width, i as usize / place.width);
                let at = (place.y + y) * rays.stride + place.x + x;
                let spread = |n: &[f32]| {
                    [
                        n[at],
                        (n[at + 1] - n[at - 1]) / 2.0,
                        (n[at + rays.stride] - n[at - rays.stride]) / 2.0,
                    ]
                };
                let (nx, ny) = (spread(&rays.nx), spread(&rays.ny));
                let own = k * count..(k + 1) * count;
                let slots = self.nx[own.clone()].iter_mut().zip(&mut self.ny[own]);
                for ((x, y), [a, b]) in slots.zip(&offsets) {
                    *x = nx[0] + a * nx[1] + b * nx[2];
                    *y = ny[0] + a * ny[1] + b * ny[2];
                }
            }
            let n = pixels.len() * count;
            self.trace(n, view);
            self.borrow_colours(place, pixels, count, &shaded, out);
            self.shade_strangers(view, around, pixels, count, out);
        }
        self.edge_list = list;
        self.shaded = shaded;
    }

    /// Gives samples the colour that their surface has at the centre of their own pixel or of one next to it, where
    /// it shows there; the others stay in the ray buffers, counted by `strangers`. Samples of marks always stay.
    fn borrow_colours(
        &mut self,
        place: &Place,
        pixels: &[u32],
        count: usize,
        shaded: &[Vec<f32>; 3],
        out: &mut [Vec<f32>; 3],
    ) {
        let share = 1.0 / count as f32;
        self.strangers.clear();
        for (k, &i) in pixels.iter().enumerate() {
            let i = i as usize;
            let pixel = (i % place.width, i / place.width);
            let sum = self.borrowed(place, pixel, k * count..(k + 1) * count, shaded);
            for (out, sum) in out.iter_mut().zip(sum) {
                out[i] = share * sum;
            }
        }
    }

    /// Sum of the colours that samples of one pixel borrow. A function of its own: the sums stay in registers.
    #[inline(never)]
    fn borrowed(
        &mut self,
        place: &Place,
        (x, y): (usize, usize),
        samples: Range<usize>,
        shaded: &[Vec<f32>; 3],
    ) -> [f32; 3] {
        let (mut last, mut colour, mut sum) = (u32::MAX, [0.0; 3], [0.0; 3]);
        for s in samples {
            let id = self.id[s];
            if id != last {
                let Some(from) = self.neighbour(place, x, y, id) else {
                    self.strangers.push(s as u16);
                    continue;
                };
                last = id;
                colour = shaded.each_ref().map(|c| c[from]);
            }
            for (sum, colour) in sum.iter_mut().zip(colour) {
                *sum += colour;
            }
        }
        sum
    }

    /// The pixel (x, y) of the tile, or the first one next to it, whose centre sees surface `id`.
    fn neighbour(&self, place: &Place, x: usize, y: usize, id: u32) -> Option<usize> {
        if id >= u32::from(FIRST_CARD) {
            return None;
        }
        const AROUND: [(usize, usize); 9] = [
            (1, 1),
            (0, 1),
            (2, 1),
            (1, 0),
            (1, 2),
            (0, 0),
            (2, 0),
            (0, 2),
            (2, 2),
        ];
        AROUND.iter().find_map(|&(dx, dy)| {
            let (x, y) = ((x + dx).checked_sub(1)?, (y + dy).checked_sub(1)?);
            let at = y * place.width + x;
            (x < place.width && y < place.height && self.seen[at] == id).then_some(at)
        })
    }

    /// Colours of the samples in `strangers`.
    fn shade_strangers(
        &mut self,
        view: &View,
        around: &Surroundings,
        pixels: &[u32],
        count: usize,
        out: &mut [Vec<f32>; 3],
    ) {
        let n = self.strangers.len();
        if n == 0 {
            return;
        }
        for (to, &from) in self.strangers.iter().enumerate() {
            let from = usize::from(from);
            self.nx[to] = self.nx[from];
            self.ny[to] = self.ny[from];
            self.t[to] = self.t[from];
            self.id[to] = self.id[from];
        }
        let mut samples = std::mem::take(&mut self.samples);
        self.shade(view, around, n, true, &mut samples);
        let share = 1.0 / count as f32;
        for (out, samples) in out.iter_mut().zip(&samples) {
            for (&s, colour) in self.strangers.iter().zip(samples) {
                out[pixels[usize::from(s) / count] as usize] += share * colour;
            }
        }
        self.samples = samples;
    }
}

/// Place of sample s of `count` (a power of two) in a pixel on an edge: a Hammersley net, centred. Its samples have `count` different
/// places along u and along v, so that edges along the pixel grid are as finely placed as others.
fn net(s: usize, count: usize) -> [f32; 2] {
    let bits = count.trailing_zeros().max(1);
    let reversed = (s as u32).reverse_bits() >> (32 - bits);
    let at = |k: usize| (k as f32 + 0.5) / count as f32 - 0.5;
    [at(s), at(reversed as usize)]
}

#[cfg(test)]
mod tests {
    use super::net;

    /// Samples of a net are centred, and all different along either axis.
    #[test]
    fn nets_are_centred_and_stratified() {
        for count in [2, 4, 8, 16, 32, 64] {
            let all: Vec<[f32; 2]> = (0..count).map(|s| net(s, count)).collect();
            for axis in 0..2 {
                let mut seen: Vec<f32> = all.iter().map(|p| p[axis]).collect();
                seen.sort_by(f32::total_cmp);
                assert!(seen.iter().sum::<f32>().abs() < 1e-5);
                assert!(
                    seen.windows(2)
                        .all(|w| (w[1] - w[0] - 1.0 / count as f32).abs() < 1e-5)
                );
            }
        }
    }
}
