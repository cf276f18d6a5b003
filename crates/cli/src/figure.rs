//! Figures as a journal prints them: drawn here, written as SVG, and as PNG from the same SVG.
//!
//! [`canvas`] holds the primitives, [`axis`] scales and ticks, [`lines`] panels of line plots that share the x axis,
//! [`surface`] three-dimensional surfaces, [`map`] maps with contour lines. Everything is a pure function of
//! its data, so the same data give the same bytes. The typeface (Noto Sans, OFL) comes inside the program.

pub(crate) mod axis;
pub(crate) mod canvas;
pub(crate) mod colour;
mod colour_bar;
pub(crate) mod lines;
pub(crate) mod map;
pub(crate) mod surface;
pub(crate) mod text;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow};
use resvg::{tiny_skia, usvg};
use vergence_imaging::Rgb;

use crate::fault;
use crate::output;

/// Pixels of the PNG per unit of the drawing (1 unit = 1/96 inch): 192 dots per inch.
const PNG_SCALE: f32 = 2.0;

/// A finished drawing.
#[derive(Clone, Debug)]
pub(crate) struct Figure {
    svg: String,
}

impl Figure {
    /// Take a whole SVG document.
    fn new(svg: String) -> Self {
        Self { svg }
    }

    /// The drawing as an SVG document.
    pub(crate) fn svg(&self) -> &str {
        &self.svg
    }

    /// The drawing as a PNG file at 192 dots per inch.
    pub(crate) fn png(&self) -> anyhow::Result<Vec<u8>> {
        self.pixels(PNG_SCALE)?
            .encode_png()
            .context("cannot encode a figure as PNG")
    }

    /// The drawing laid over a picture, one unit per pixel.
    pub(crate) fn over(&self, picture: &Rgb) -> anyhow::Result<Rgb> {
        let drawing = self.pixels(1.0)?;
        let mut out = picture.clone();
        let (width, height) = (drawing.width() as usize, drawing.height() as usize);
        for y in 0..height.min(out.height()) {
            let row = &drawing.pixels()[y * width..(y + 1) * width];
            for (px, ink) in out.row_mut(y).iter_mut().zip(row) {
                // The drawing's colours are premultiplied by their alpha.
                let rest = 255 - u32::from(ink.alpha());
                for (value, ink) in px.iter_mut().zip([ink.red(), ink.green(), ink.blue()]) {
                    *value =
                        (u32::from(ink) + (u32::from(*value) * rest + 127) / 255).min(255) as u8;
                }
            }
        }
        Ok(out)
    }

    fn pixels(&self, scale: f32) -> anyhow::Result<tiny_skia::Pixmap> {
        let mut fonts = usvg::fontdb::Database::new();
        for bytes in text::FONTS {
            fonts.load_font_data(bytes.to_vec());
        }
        let options = usvg::Options {
            font_family: text::FAMILY.to_owned(),
            fontdb: Arc::new(fonts),
            ..usvg::Options::default()
        };
        let tree = usvg::Tree::from_str(self.svg(), &options).context("cannot read our own SVG")?;
        let size = tree.size();
        let (width, height) = (size.width() * scale, size.height() * scale);
        let mut pixels = tiny_skia::Pixmap::new(width.ceil() as u32, height.ceil() as u32)
            .ok_or_else(|| anyhow!("a figure of {width} x {height} pixels has no area"))?;
        let transform = tiny_skia::Transform::from_scale(scale, scale);
        resvg::render(&tree, transform, &mut pixels.as_mut());
        Ok(pixels)
    }

    /// Write `DIR/NAME.svg` and `DIR/NAME.png`; the directory is made when it is not there.
    pub(crate) fn save(&self, dir: &Path, name: &str) -> anyhow::Result<[PathBuf; 2]> {
        fs::create_dir_all(dir)
            .map_err(|e| fault::failed(format!("cannot make the folder {}: {e}", dir.display())))?;
        let png = self.png()?;
        let paths = ["svg", "png"].map(|kind| dir.join(format!("{name}.{kind}")));
        output::write_file(&paths[0], self.svg().as_bytes())?;
        output::write_file(&paths[1], &png)?;
        Ok(paths)
    }
}

#[cfg(test)]
mod tests;
