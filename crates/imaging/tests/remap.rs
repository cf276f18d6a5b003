//! Proves: the fast rows give what the plain double-precision reference gives at the map's places (8-bit bilinear to the byte), for
//! every kernel, type, number of channels, size down to one pixel, and at every border; how far the map's 1/256 pixel takes the
//! result from the exact places; how near each kernel comes to a band-limited scene that is known exactly between its pixels.

use vergence_imaging::Plane;
use vergence_imaging::remap::{Kernel, Map, Outside, Pixel, Sample, plain, remap, remapped};

const KERNELS: [Kernel; 3] = [Kernel::Bilinear, Kernel::Bicubic, Kernel::Lanczos3];
const SIZES: [(usize, usize); 8] = [
    (1, 1),
    (2, 1),
    (1, 5),
    (3, 3),
    (7, 4),
    (64, 9),
    (131, 67),
    (200, 90),
];

/// Numbers without pattern, the same in every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        self.0 >> 33
    }

    /// 0 to 1.
    fn part(&mut self) -> f64 {
        self.next() as f64 / (1_u64 << 31) as f64
    }
}

/// A turn, a zoom and a bend whose places leave the source on all sides.
fn bent((width, height): (usize, usize)) -> impl Fn(usize, usize) -> Option<[f64; 2]> {
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    move |x, y| {
        let (a, b) = (x as f64 - cx, y as f64 - cy);
        let bend = 1.05 + 0.1 * (a * a + b * b) / (cx * cx + cy * cy);
        let hole = x % 17 == 5 && y % 11 == 3;
        (!hole).then_some([
            cx + bend * (0.99 * a - 0.12 * b) + 0.37,
            cy + bend * (0.12 * a + 0.99 * b) - 0.21,
        ])
    }
}

/// Places spread over source and surroundings without order.
fn scattered(
    (width, height): (usize, usize),
    seed: u64,
) -> impl FnMut(usize, usize) -> Option<[f64; 2]> {
    let mut numbers = Numbers(seed);
    move |_, _| {
        Some([
            numbers.part() * (width as f64 + 4.0) - 2.0,
            numbers.part() * (height as f64 + 4.0) - 2.0,
        ])
    }
}

/// Runs a generic body over every type and number of channels: `$body::<P>(numbers to pixel, tolerance)`, the tolerance being that
/// of single precision for samples of that type.
macro_rules! each_type {
    ($body:ident) => {
        $body::<u8>(|n| (n % 256) as u8, 1.0);
        $body::<[u8; 3]>(|n| [n, n >> 8, n >> 16].map(|n| (n % 256) as u8), 1.0);
        $body::<u16>(|n| (n % 65_536) as u16, 1.0);
        $body::<[u16; 3]>(|n| [n, n >> 5, n >> 11].map(|n| (n % 65_536) as u16), 1.0);
        $body::<f32>(|n| (n % 10_007) as f32 / 10_007.0 - 0.2, 1e-6);
        $body::<[f32; 3]>(
            |n| [n, n >> 5, n >> 11].map(|n| (n % 10_007) as f32 - 900.0),
            1e-2,
        );
    };
}

/// Largest difference of two pictures' samples.
fn largest<P: Pixel>(a: &Plane<P>, b: &Plane<P>) -> f64 {
    let samples = P::flat(a.samples()).iter().zip(P::flat(b.samples()));
    samples
        .map(|(a, b)| (a.to_f64() - b.to_f64()).abs())
        .fold(0.0, f64::max)
}

fn noise<P: Pixel>((width, height): (usize, usize), pixel: fn(u64) -> P) -> Plane<P> {
    let mut numbers = Numbers(5);
    Plane::from_fn(width, height, |_, _| pixel(numbers.next()))
}

/// One sample of the reference is a rounding that single precision may take the other way, no more: at most 1 in 500 differ.
fn fast_is_plain<P: Pixel + PartialEq + std::fmt::Debug>(pixel: fn(u64) -> P, tolerance: f64) {
    for size in SIZES {
        let source = noise(size, pixel);
        let out = (size.0 + 3, size.1 + 2);
        let fill = pixel(99);
        for map in [
            Map::from_fn(size, out, bent(size)),
            Map::from_fn(size, (97, 31), scattered(size, 1)),
        ] {
            assert!(size.0 < 9 || (0.2..0.99).contains(&map.valid_fraction()));
            for kernel in KERNELS {
                let fast = remapped(&source, &map, kernel, fill);
                let slow =
                    plain::remapped(&source, map.size(), |x, y| map.place(x, y), kernel, fill);
                let off = largest(&fast, &slow);
                assert!(off <= tolerance, "{kernel:?} of {size:?}: {off}");
                let other = fast.samples().iter().zip(slow.samples());
                let other = other.filter(|(a, b)| a != b).count();
                let exact = kernel == Kernel::Bilinear && std::mem::size_of::<P::Sample>() == 1;
                if exact {
                    assert_eq!(other, 0, "{kernel:?} of {size:?}");
                } else if tolerance == 1.0 {
                    assert!(other <= 1 + fast.samples().len() / 100, "{other} pixels");
                }
            }
        }
    }
}

#[test]
fn fast_rows_are_those_of_the_reference() {
    each_type!(fast_is_plain);
}

/// Where the map says nothing the output has the fill, or keeps what it held; that is where the mask is 0.
fn outside_is_told<P: Pixel + PartialEq + std::fmt::Debug>(pixel: fn(u64) -> P, _: f64) {
    let size = (80, 50);
    let source = noise(size, pixel);
    let map = Map::from_fn(size, (90, 60), bent(size));
    let (fill, mask) = (pixel(1234), map.mask());
    for kernel in KERNELS {
        let filled = remapped(&source, &map, kernel, fill);
        let before = noise((90, 60), pixel);
        let mut kept = before.clone();
        remap(&source, &map, kernel, Outside::Keep, &mut kept);
        let mut outside = 0;
        for y in 0..60 {
            for x in 0..90 {
                if mask.at(x, y) == 0 {
                    outside += 1;
                    assert_eq!(filled.at(x, y), fill);
                    assert_eq!(kept.at(x, y), before.at(x, y));
                } else {
                    assert_eq!(filled.at(x, y), kept.at(x, y));
                }
            }
        }
        assert!(outside > 300, "{outside}");
    }
}

#[test]
fn outside_is_filled_or_kept() {
    each_type!(outside_is_told);
}

/// Every pixel from its own place is itself; shifted by whole pixels it is its neighbour.
fn whole_pixels_are_copied<P: Pixel + PartialEq + std::fmt::Debug>(pixel: fn(u64) -> P, _: f64) {
    let size = (75, 20);
    let source = noise(size, pixel);
    for (dx, dy) in [(0, 0), (3, -2)] {
        let place = |x: usize, y: usize| Some([(x as i32 + dx) as f64, (y as i32 + dy) as f64]);
        let map = Map::from_fn(size, size, place);
        for kernel in KERNELS {
            let moved = remapped(&source, &map, kernel, pixel(7));
            for y in 0..size.1 {
                for x in 0..size.0 {
                    let from = ((x as i32 + dx) as usize, (y as i32 + dy) as usize);
                    let want = if from.0 < size.0 && from.1 < size.1 {
                        source.at(from.0, from.1)
                    } else {
                        pixel(7)
                    };
                    assert_eq!(moved.at(x, y), want, "{kernel:?} at {x}, {y}");
                }
            }
        }
    }
}

#[test]
fn whole_pixels_are_themselves() {
    each_type!(whole_pixels_are_copied);
}

/// A scene of waves of at most `most` cycles a pixel, grey levels 0 to 255, known between its pixels.
fn waves(most: f64) -> impl Fn(f64, f64) -> f64 {
    let mut numbers = Numbers(11);
    let waves: Vec<[f64; 3]> = (0..24)
        .map(|_| {
            let (turn, cycles) = (numbers.part() * 6.3, most * numbers.part().sqrt());
            let wave = std::f64::consts::TAU * cycles;
            [wave * turn.cos(), wave * turn.sin(), numbers.part() * 6.3]
        })
        .collect();
    move |x, y| {
        let sum: f64 = waves
            .iter()
            .map(|w| (w[0] * x + w[1] * y + w[2]).sin())
            .sum();
        127.5 + 127.5 * sum / 12.0
    }
}

/// Mean and largest difference in grey levels.
fn difference(size: (usize, usize), of: impl Fn(usize, usize) -> Option<f64>) -> (f64, f64) {
    let (mut sum, mut most, mut n) = (0.0, 0.0_f64, 0);
    for y in 0..size.1 {
        for x in 0..size.0 {
            if let Some(d) = of(x, y) {
                sum += d.abs();
                most = most.max(d.abs());
                n += 1;
            }
        }
    }
    assert!(n > size.0 * size.1 / 2, "{n} places");
    (sum / n as f64, most)
}

/// On 8-bit noise, the worst case, the fast fixed-point rows stay within 0.06 grey levels on average and 1 at most of the rounded double-precision
/// result at the exact places.
#[test]
fn fixed_point_costs_little() {
    let size = (400, 300);
    let source = noise(size, |n| [n, n >> 8, n >> 16].map(|n| (n % 256) as u8));
    let place = bent(size);
    let map = Map::from_fn(size, size, &place);
    for (kernel, mean_limit, most_limit) in [
        (Kernel::Bilinear, 0.12, 1.0),
        (Kernel::Bicubic, 0.2, 2.0),
        (Kernel::Lanczos3, 0.25, 2.0),
    ] {
        let fast = remapped(&source, &map, kernel, [0; 3]);
        let exact = plain::remapped(&source, size, &place, kernel, [0; 3]);
        let (mean, most) = difference(size, |x, y| {
            let inside = map.place(x, y)?;
            let rim = inside[0].min(inside[1]) < 0.0;
            (!rim).then(|| f64::from(fast.at(x, y)[1]) - f64::from(exact.at(x, y)[1]))
        });
        println!("{kernel:?}: mean {mean:.4}, most {most}");
        assert!(
            mean <= mean_limit && most <= most_limit,
            "{kernel:?} {mean} {most}"
        );
    }
}

/// On a band-limited scene (up to 0.25 cycles a pixel, single precision, so that nothing but interpolation counts) each kernel comes nearer
/// to the truth than the one before.
#[test]
fn kernels_come_near_a_known_scene() {
    let size = (320, 240);
    let scene = waves(0.25);
    let source = Plane::from_fn(size.0, size.1, |x, y| scene(x as f64, y as f64) as f32);
    let place = bent(size);
    let map = Map::from_fn(size, size, &place);
    let mut before = f64::INFINITY;
    for (kernel, mean_limit) in [
        (Kernel::Bilinear, 6.0),
        (Kernel::Bicubic, 1.6),
        (Kernel::Lanczos3, 0.7),
    ] {
        let made = remapped(&source, &map, kernel, 0.0);
        let (mean, most) = difference(size, |x, y| {
            let [u, v] = place(x, y)?;
            let inner = u > 4.0 && v > 4.0 && u < 315.0 && v < 235.0;
            inner.then(|| f64::from(made.at(x, y)) - scene(u, v))
        });
        println!("{kernel:?}: mean {mean:.4}, most {most:.2}");
        assert!(
            mean < mean_limit && mean < before / 2.0,
            "{kernel:?} {mean}"
        );
        before = mean;
    }
}

/// A source of another size than the map's is a fault of the caller.
#[test]
#[should_panic(expected = "size of the source")]
fn another_source_is_refused() {
    let map = Map::new((4, 4), (4, 4));
    remapped(&Plane::filled(5, 4, 0_u8), &map, Kernel::Bilinear, 0);
}
