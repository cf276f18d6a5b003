//! The room: walls with relief, furniture, a few round things, all at rest.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::figure::FLOOR_M;
use crate::hash::Draws;
use crate::material::{Material, Palette};
use crate::solid::{Limb, Solid};
use crate::texture::Pattern;

/// Inside of the walls, base frame, m: lowest and highest x, y (ceiling, floor) and z.
pub const ROOM: [[f64; 2]; 3] = [[-3.6, 3.6], [FLOOR_M - 2.75, FLOOR_M], [-1.5, 12.4]];

/// What a surface belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Object {
    /// Nothing: beyond the room (no ray of a camera inside it gets there).
    Nothing = 0,
    /// Walls, floor, ceiling.
    Room = 1,
    /// Everything that stands or hangs in it.
    Furniture = 2,
    /// The pillar of the path `occlude`.
    Pillar = 3,
    /// The person to follow.
    Person = 4,
    /// The other person of the path `two`.
    SecondPerson = 5,
    /// A calibration mark.
    Mark = 6,
}

/// A box with faces along the axes of the base frame.
#[derive(Clone, Copy, Debug)]
pub struct Cuboid {
    /// Lowest corner, m.
    pub lo: Point3<f64>,
    /// Highest corner, m.
    pub hi: Point3<f64>,
    /// Index into [`Palette::materials`].
    pub material: u16,
    /// What it is part of.
    pub object: Object,
    /// What a person calls it.
    pub name: &'static str,
}

/// Everything at rest.
#[derive(Clone, Debug)]
pub struct Room {
    /// Materials of the room's faces: left, right, ceiling, floor, behind the rig, far end.
    pub faces: [u16; 6],
    /// Boxes.
    pub cuboids: Vec<Cuboid>,
    /// Round things.
    pub solids: Vec<Solid>,
}

struct Builder<'a> {
    palette: &'a mut Palette,
    cuboids: Vec<Cuboid>,
    solids: Vec<Solid>,
    draws: Draws,
}

impl Room {
    /// The furnished room of a seed; the pillar stands only where `pillar` says so.
    pub(crate) fn new(palette: &mut Palette, seed: u64, pillar: bool) -> Self {
        let mut draws = Draws::new(seed, 21);
        const WALLS: [(u32, u32); 5] = [
            (0xc3_b9a4, 0xdc_d3c0),
            (0xa9_b8b4, 0xc6_d2ce),
            (0xc4_ae98, 0xdd_cab6),
            (0xb0_b6c0, 0xcb_d0d8),
            (0xb6_bba0, 0xd0_d4bc),
        ];
        let (dark, bright) = WALLS[draws.below(WALLS.len())];
        let wall = palette.add(Material::two(Pattern::Plaster, 1.9, dark, bright));
        let end = palette.add(Material::two(Pattern::Plaster, 1.6, dark, bright));
        let ceiling = palette.add(Material::two(Pattern::Plaster, 2.6, 0xd8_d5ce, 0xee_ece6));
        let floor = palette.add(Material::three(
            Pattern::Boards,
            1.6,
            [0x4a_3220, 0x8e_6844, 0xb8_9468],
        ));
        let mut b = Builder {
            palette,
            cuboids: Vec::new(),
            solids: Vec::new(),
            draws,
        };
        b.skirting();
        b.far_end();
        b.left_side();
        b.right_side();
        b.ceiling();
        if pillar {
            b.pillar();
        }
        Self {
            faces: [wall, wall, ceiling, floor, end, end],
            cuboids: b.cuboids,
            solids: b.solids,
        }
    }
}

impl Builder<'_> {
    /// A box given by its ranges of x, height above the floor and z.
    fn put(
        &mut self,
        name: &'static str,
        x: [f64; 2],
        height: [f64; 2],
        z: [f64; 2],
        material: u16,
    ) {
        self.cuboids.push(Cuboid {
            lo: Point3::new(x[0], FLOOR_M - height[1], z[0]),
            hi: Point3::new(x[1], FLOOR_M - height[0], z[1]),
            material,
            object: Object::Furniture,
            name,
        });
    }

    fn two(&mut self, pattern: Pattern, tile_m: f64, dark: u32, bright: u32) -> u16 {
        self.palette
            .add(Material::two(pattern, tile_m as f32, dark, bright))
    }

    fn skirting(&mut self) {
        let [x, _, z] = ROOM;
        let white = self.two(Pattern::Grain, 0.8, 0xc4_bfb4, 0xe2_dfd6);
        let high = [0.0, 0.11];
        self.put("the skirting board", [x[0], x[0] + 0.016], high, z, white);
        self.put("the skirting board", [x[1] - 0.016, x[1]], high, z, white);
        self.put("the skirting board", x, high, [z[1] - 0.016, z[1]], white);
    }

    fn far_end(&mut self) {
        let end = ROOM[2][1];
        self.door(-2.5, end);
        self.bookshelf(0.9, 2.9, end);
        self.picture_on_end(-0.75, 0.55, 1.05, 1.95, end, 0.40);
        let brass = self.two(Pattern::Grain, 0.1, 0x80_6a30, 0xd8_c080);
        self.put(
            "a light switch",
            [-1.32, -1.24],
            [1.05, 1.13],
            [end - 0.015, end],
            brass,
        );
        // A bench below the picture.
        let wood = self.two(Pattern::Grain, 0.7, 0x5c_3c22, 0xa0_7448);
        self.put(
            "the bench",
            [-0.95, 0.65],
            [0.40, 0.45],
            [end - 0.42, end - 0.04],
            wood,
        );
        for x in [-0.88, 0.52] {
            self.put(
                "the bench",
                [x, x + 0.06],
                [0.0, 0.40],
                [end - 0.40, end - 0.06],
                wood,
            );
        }
        let cushion = self.palette.add(Material::three(
            Pattern::Leaves,
            0.3,
            [0x8a_2f28, 0xd8_8a40, 0xf0_e0b0],
        ));
        self.put(
            "a cushion",
            [-0.8, -0.35],
            [0.45, 0.55],
            [end - 0.40, end - 0.06],
            cushion,
        );
    }

    fn door(&mut self, x: f64, end: f64) {
        let frame = self.two(Pattern::Grain, 0.9, 0xb8_b2a4, 0xdc_d8cc);
        let leaf = self.two(Pattern::Grain, 0.9, 0x6a_4c30, 0x9c_7850);
        let inset = self.two(Pattern::Grain, 0.9, 0x58_3e26, 0x86_6440);
        self.put(
            "the door",
            [x - 0.09, x],
            [0.0, 2.12],
            [end - 0.06, end],
            frame,
        );
        self.put(
            "the door",
            [x + 0.86, x + 0.95],
            [0.0, 2.12],
            [end - 0.06, end],
            frame,
        );
        self.put(
            "the door",
            [x - 0.09, x + 0.95],
            [2.03, 2.12],
            [end - 0.062, end],
            frame,
        );
        self.put(
            "the door",
            [x, x + 0.86],
            [0.0, 2.03],
            [end - 0.025, end],
            leaf,
        );
        for (low, high) in [(0.2, 0.85), (1.05, 1.85)] {
            for side in [0.10, 0.46] {
                self.put(
                    "the door",
                    [x + side, x + side + 0.30],
                    [low, high],
                    [end - 0.034, end],
                    inset,
                );
            }
        }
        let brass = self.two(Pattern::Grain, 0.1, 0x80_6a30, 0xd8_c080);
        self.put(
            "the door",
            [x + 0.76, x + 0.82],
            [0.98, 1.01],
            [end - 0.07, end - 0.02],
            brass,
        );
    }

    fn bookshelf(&mut self, x0: f64, x1: f64, end: f64) {
        let wood = self.two(Pattern::Grain, 0.8, 0x6c_4c2e, 0xa8_8258);
        let (front, top) = (end - 0.30, 2.05);
        for x in [x0, (x0 + x1) / 2.0 - 0.0125, x1 - 0.025] {
            self.put(
                "the bookshelf",
                [x, x + 0.025],
                [0.0, top],
                [front, end],
                wood,
            );
        }
        let boards = [0.08, 0.46, 0.84, 1.20, 1.55, 1.87, 2.05];
        for h in boards {
            self.put(
                "the bookshelf",
                [x0, x1],
                [h - 0.025, h],
                [front, end],
                wood,
            );
        }
        let spines: Vec<u16> = [
            (0x5a_1c1a, 0x9c_3c34),
            (0x1c_3450, 0x3c_6c98),
            (0x20_4430, 0x4c_8460),
            (0xa8_8a50, 0xd8_c08c),
            (0xb8_b4a8, 0xe4_e0d4),
            (0x38_2444, 0x74_5488),
            (0x20_2024, 0x50_5058),
            (0xa0_5020, 0xe0_8848),
        ]
        .into_iter()
        .map(|(a, b)| self.two(Pattern::Cloth, 0.25, a, b))
        .collect();
        for h in &boards[..6] {
            let mut x = x0 + 0.03;
            while x < x1 - 0.12 {
                // Gaps and blocks: books of one row or set stand as one block of a colour.
                let width = self.draws.between(0.05, 0.20);
                let high = self.draws.between(0.19, 0.29);
                let deep = self.draws.between(0.03, 0.09);
                let middle = (x0 + x1) / 2.0;
                if x < middle && x + width > middle - 0.02 {
                    x = middle + 0.02;
                    continue;
                }
                let colour = spines[self.draws.below(spines.len())];
                let width = width.min(x1 - 0.03 - x);
                self.put(
                    "the bookshelf",
                    [x, x + width],
                    [*h, h + high],
                    [front + deep, end],
                    colour,
                );
                x += width
                    + if self.draws.unit() < 0.2 {
                        self.draws.between(0.05, 0.2)
                    } else {
                        0.004
                    };
            }
        }
    }

    /// A framed picture on the far wall: x from, x to, height from, height to.
    fn picture_on_end(&mut self, x0: f64, x1: f64, h0: f64, h1: f64, end: f64, tile_m: f64) {
        let (frame, art) = self.frame_and_art(tile_m);
        self.put(
            "a picture",
            [x0 - 0.04, x1 + 0.04],
            [h0 - 0.04, h1 + 0.04],
            [end - 0.025, end],
            frame,
        );
        self.put("a picture", [x0, x1], [h0, h1], [end - 0.032, end], art);
    }

    fn frame_and_art(&mut self, tile_m: f64) -> (u16, u16) {
        const SETS: [[u32; 3]; 5] = [
            [0x1c_3a5c, 0x8a_a878, 0xf0_e0b8],
            [0x3a_1a1a, 0xc0_6030, 0xf4_d890],
            [0x10_2a24, 0x4c_8c74, 0xe8_ecd0],
            [0x2a_2038, 0x9c_5878, 0xf0_d0c0],
            [0x1a_2a40, 0x5c_84b0, 0xf0_f0e8],
        ];
        let frame = self.two(Pattern::Grain, 0.5, 0x2c_1e12, 0x6c_4c2c);
        let pattern = [Pattern::Painting, Pattern::Leaves][self.draws.below(2)];
        let set = SETS[self.draws.below(SETS.len())];
        let art = self
            .palette
            .add(Material::three(pattern, tile_m as f32 * 2.0, set));
        (frame, art)
    }

    fn picture_on_side(&mut self, right: bool, z: [f64; 2], height: [f64; 2]) {
        let (frame, art) = self.frame_and_art(z[1] - z[0]);
        let wall = |deep: f64| {
            if right {
                [ROOM[0][1] - deep, ROOM[0][1]]
            } else {
                [ROOM[0][0], ROOM[0][0] + deep]
            }
        };
        let grown = |r: [f64; 2]| [r[0] - 0.04, r[1] + 0.04];
        self.put("a picture", wall(0.025), grown(height), grown(z), frame);
        self.put("a picture", wall(0.032), height, z, art);
    }

    fn left_side(&mut self) {
        let wall = ROOM[0][0];
        self.sofa(wall, 5.6);
        self.picture_on_side(false, [5.9, 7.3], [1.15, 2.0]);
        self.window(wall, [8.6, 10.4]);
        // Low cupboard with a vase near the door.
        let wood = self.two(Pattern::Grain, 0.8, 0x3c_2818, 0x7c_5834);
        self.put(
            "the cupboard",
            [wall, wall + 0.45],
            [0.06, 0.86],
            [2.3, 3.8],
            wood,
        );
        self.put(
            "the cupboard",
            [wall, wall + 0.47],
            [0.86, 0.89],
            [2.28, 3.82],
            wood,
        );
        let glaze = self.two(Pattern::Clouds, 0.3, 0x1c_4458, 0x9c_c0c0);
        let foot = Point3::new(wall + 0.24, FLOOR_M - 0.98, 3.4);
        self.vase(foot, glaze);
        self.picture_on_side(false, [2.5, 3.2], [1.25, 1.95]);
        let rug = self.palette.add(Material::three(
            Pattern::Carpet,
            1.4,
            [0x5c_2420, 0x9c_6448, 0xd8_c4a0],
        ));
        self.put("the rug", [-1.3, 1.3], [0.0, 0.008], [6.2, 9.0], rug);
    }

    fn vase(&mut self, at: Point3<f64>, material: u16) {
        let limb = Limb {
            start: at,
            start_radius: 0.09,
            end: at - Vector3::new(0.0, 0.20, 0.0),
            end_radius: 0.04,
        };
        self.solids
            .push(Solid::limb(&limb, &Vector3::z(), 1.0, material));
    }

    fn sofa(&mut self, wall: f64, z: f64) {
        let cloth = self.two(Pattern::Cloth, 0.5, 0x2c_4450, 0x64_8490);
        let seat = self.two(Pattern::Cloth, 0.45, 0x30_4a58, 0x6c_8e9c);
        let name = "the sofa";
        self.put(
            name,
            [wall + 0.04, wall + 0.24],
            [0.10, 0.82],
            [z, z + 2.1],
            cloth,
        );
        self.put(
            name,
            [wall + 0.20, wall + 0.86],
            [0.10, 0.32],
            [z, z + 2.1],
            cloth,
        );
        for side in [z - 0.02, z + 1.94] {
            self.put(
                name,
                [wall + 0.06, wall + 0.88],
                [0.08, 0.60],
                [side, side + 0.18],
                cloth,
            );
        }
        for i in 0..2 {
            let from = z + 0.17 + 0.89 * f64::from(i);
            self.put(
                name,
                [wall + 0.24, wall + 0.89],
                [0.32, 0.45],
                [from, from + 0.87],
                seat,
            );
        }
        let cushion = self.palette.add(Material::three(
            Pattern::Plaid,
            0.3,
            [0xb0_4a30, 0xe0_b060, 0xf4_ecd0],
        ));
        self.solids.push(Solid::ellipsoid(
            Point3::new(wall + 0.36, FLOOR_M - 0.62, z + 0.45),
            &Matrix3::identity(),
            &Vector3::new(0.09, 0.19, 0.21),
            cushion,
        ));
    }

    fn window(&mut self, wall: f64, z: [f64; 2]) {
        let frame = self.two(Pattern::Grain, 0.8, 0xc8_c4ba, 0xf0_eee8);
        let mut sky = Material::three(Pattern::Clouds, 2.4, [0x8c_b0dc, 0xc0_d4ec, 0xf8_faff]);
        sky.glow = 1.0;
        let sky = self.palette.add(sky);
        self.put("the window", [wall, wall + 0.012], [0.9, 2.2], z, sky);
        let middle = (z[0] + z[1]) / 2.0;
        for (h, r) in [([0.84, 0.92], 0.12), ([2.18, 2.26], 0.06)] {
            self.put(
                "the window",
                [wall, wall + r],
                h,
                [z[0] - 0.06, z[1] + 0.06],
                frame,
            );
        }
        for at in [z[0] - 0.03, middle - 0.03, z[1] - 0.03] {
            self.put(
                "the window",
                [wall, wall + 0.05],
                [0.92, 2.18],
                [at, at + 0.06],
                frame,
            );
        }
    }

    fn right_side(&mut self) {
        let wall = ROOM[0][1];
        let wood = self.two(Pattern::Grain, 0.9, 0x70_5030, 0xb8_9060);
        let front = self.two(Pattern::Grain, 0.9, 0x80_6038, 0xc4_9c6c);
        let name = "the sideboard";
        self.put(name, [wall - 0.46, wall], [0.12, 0.80], [4.0, 6.2], wood);
        self.put(name, [wall - 0.49, wall], [0.80, 0.83], [3.97, 6.23], wood);
        for i in 0..4 {
            let z = 4.04 + 0.54 * f64::from(i);
            self.put(
                name,
                [wall - 0.475, wall - 0.3],
                [0.16, 0.76],
                [z, z + 0.50],
                front,
            );
        }
        self.picture_on_side(true, [4.3, 5.1], [1.2, 1.85]);
        self.picture_on_side(true, [5.35, 5.95], [1.2, 1.85]);
        self.lamp(Point3::new(wall - 0.24, FLOOR_M - 0.83, 5.75));
        self.plant(Point3::new(wall - 0.45, FLOOR_M, 10.9));
        self.picture_on_side(true, [7.6, 9.2], [1.05, 2.0]);
        self.chair(wall - 0.55, 8.3);
        // Boxes left near the front, on the right.
        let card = self.two(Pattern::Cloth, 0.7, 0x8c_6c44, 0xc0_a070);
        self.put(
            "a box",
            [wall - 0.62, wall - 0.08],
            [0.0, 0.42],
            [2.4, 3.0],
            card,
        );
        let card = self.two(Pattern::Cloth, 0.6, 0x9c_7c54, 0xc8_a87c);
        self.put(
            "a box",
            [wall - 0.55, wall - 0.12],
            [0.42, 0.74],
            [2.5, 2.95],
            card,
        );
    }

    fn lamp(&mut self, foot: Point3<f64>) {
        let brass = self.two(Pattern::Grain, 0.1, 0x60_5028, 0xc8_b070);
        let mut shade = Material::two(Pattern::Cloth, 0.3, 0xe0_c898, 0xff_f0d0);
        shade.glow = 0.35;
        let shade = self.palette.add(shade);
        let up = |h: f64| foot - Vector3::new(0.0, h, 0.0);
        let limb = |start, start_radius, end, end_radius| Limb {
            start,
            start_radius,
            end,
            end_radius,
        };
        let front = Vector3::z();
        self.solids.push(Solid::limb(
            &limb(up(0.03), 0.075, up(0.06), 0.05),
            &front,
            1.0,
            brass,
        ));
        self.solids.push(Solid::limb(
            &limb(up(0.05), 0.013, up(0.34), 0.012),
            &front,
            1.0,
            brass,
        ));
        self.solids.push(Solid::limb(
            &limb(up(0.36), 0.125, up(0.47), 0.075),
            &front,
            1.0,
            shade,
        ));
    }

    fn plant(&mut self, foot: Point3<f64>) {
        let pot = self.two(Pattern::Clouds, 0.5, 0x8a_4428, 0xc8_7c50);
        let leaf = self.two(Pattern::Grain, 0.2, 0x1c_3c18, 0x68_9848);
        let up = |h: f64| foot - Vector3::new(0.0, h, 0.0);
        self.solids.push(Solid::limb(
            &Limb {
                start: up(0.12),
                start_radius: 0.13,
                end: up(0.30),
                end_radius: 0.18,
            },
            &Vector3::z(),
            1.0,
            pot,
        ));
        for i in 0..13 {
            let turn = f64::from(i) * 2.399_963;
            let out = self.draws.between(0.10, 0.34);
            let rise = 1.30 - 1.6 * out * out - 0.045 * f64::from(i % 5);
            let (s, c) = turn.sin_cos();
            let tip = up(rise.max(0.6)) + Vector3::new(s * out, 0.0, c * out);
            let along = (tip - up(0.40)).normalize();
            let across = along.cross(&Vector3::y()).normalize();
            let axes = Matrix3::from_columns(&[across, along, across.cross(&along)]);
            let middle = up(0.40) + (tip - up(0.40)) * 0.68;
            self.solids.push(Solid::ellipsoid(
                middle,
                &axes,
                &Vector3::new(0.065, 0.30 * (0.7 + out), 0.012),
                leaf,
            ));
        }
    }

    fn chair(&mut self, x: f64, z: f64) {
        let wood = self.two(Pattern::Grain, 0.5, 0x48_2c18, 0x8c_6038);
        let name = "the chair";
        self.put(
            name,
            [x - 0.22, x + 0.22],
            [0.44, 0.47],
            [z - 0.22, z + 0.22],
            wood,
        );
        for (dx, dz, high) in [
            (-0.2, -0.2, 0.45),
            (-0.2, 0.2, 0.45),
            (0.2, -0.2, 0.95),
            (0.2, 0.2, 0.95),
        ] {
            let (px, pz) = (x + dx, z + dz);
            self.put(
                name,
                [px - 0.02, px + 0.02],
                [0.0, high],
                [pz - 0.02, pz + 0.02],
                wood,
            );
        }
        for h in [0.62, 0.76, 0.90] {
            self.put(
                name,
                [x + 0.19, x + 0.21],
                [h, h + 0.06],
                [z - 0.2, z + 0.2],
                wood,
            );
        }
    }

    fn ceiling(&mut self) {
        let mut panel = Material::two(Pattern::Plaster, 1.0, 0xf8_f4ea, 0xff_ffff);
        panel.glow = 1.25;
        let panel = self.palette.add(panel);
        for z in [1.6, 4.6, 7.6, 10.6] {
            self.put(
                "a ceiling light",
                [-0.6, 0.6],
                [2.72, 2.75],
                [z - 0.15, z + 0.15],
                panel,
            );
        }
    }

    fn pillar(&mut self) {
        let stone = self.palette.add(Material::three(
            Pattern::Clouds,
            0.8,
            [0x70_6a60, 0xa8_a090, 0xd0_c8b8],
        ));
        let first = self.cuboids.len();
        self.put("the pillar", [0.26, 0.78], [0.0, 2.75], [3.4, 3.9], stone);
        self.put("the pillar", [0.22, 0.82], [0.0, 0.22], [3.36, 3.94], stone);
        self.put(
            "the pillar",
            [0.22, 0.82],
            [2.60, 2.75],
            [3.36, 3.94],
            stone,
        );
        for c in &mut self.cuboids[first..] {
            c.object = Object::Pillar;
        }
    }
}
