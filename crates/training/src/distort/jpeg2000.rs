//! JPEG 2000 through `openjp2`, the port of OpenJPEG: 9/7 wavelet, six resolutions, code blocks of 64 x 64.
//!
//! The crate's safe interface reads and writes files only, so a code stream goes through a temporary one.

use anyhow::{Context as _, ensure};
use openjp2::openjpeg::{OPJ_CLRSPC_GRAY, OPJ_CODEC_J2K};
use openjp2::{
    Codec, Stream, opj_cparameters_t, opj_dparameters_t, opj_image, opj_image_comptparm,
};
use tempfile::NamedTempFile;
use vergence_imaging::Gray;

/// Bytes read or written at once.
const BUFFER: usize = 1 << 16;

/// How a picture is coded.
#[derive(Clone, Debug, PartialEq)]
pub struct Coding {
    /// Compression ratio reached by each quality layer, falling; the last is that of the file.
    pub ratios: Vec<f64>,
    /// Side of the precincts at every resolution, with a marker before each packet; none for one precinct a resolution.
    pub precinct: Option<usize>,
}

/// Number of resolutions: five levels of the wavelet transform.
pub const RESOLUTIONS: usize = 6;

/// Coded at a ratio and decoded again.
pub fn through(picture: &Gray, ratio: f64) -> anyhow::Result<Gray> {
    let coding = Coding {
        ratios: vec![ratio],
        precinct: None,
    };
    decoded(&encoded(picture, &coding)?)
}

/// The code stream of a picture.
// The settings have a destructor, so they cannot be taken apart in an initialiser.
#[allow(clippy::field_reassign_with_default)]
pub fn encoded(picture: &Gray, coding: &Coding) -> anyhow::Result<Vec<u8>> {
    let mut parameters = opj_cparameters_t::default();
    parameters.irreversible = 1;
    parameters.cp_disto_alloc = 1;
    parameters.numresolution = RESOLUTIONS as i32;
    parameters.tcp_numlayers = i32::try_from(coding.ratios.len())?;
    for (slot, &ratio) in parameters.tcp_rates.iter_mut().zip(&coding.ratios) {
        *slot = ratio as f32;
    }
    if let Some(side) = coding.precinct {
        // Scod of the standard: bit 0 precincts of given size, bit 1 SOP markers.
        parameters.csty = 0b11;
        parameters.res_spec = RESOLUTIONS as i32;
        for i in 0..RESOLUTIONS {
            parameters.prcw_init[i] = i32::try_from(side)?;
            parameters.prch_init[i] = i32::try_from(side)?;
        }
    }
    let mut image = coder_image(picture)?;
    let file = NamedTempFile::new()?;
    let mut codec = Codec::new_encoder(OPJ_CODEC_J2K).context("no JPEG 2000 encoder")?;
    ensure!(
        codec.setup_encoder(&mut parameters, &mut image) != 0,
        "the encoder refuses its settings"
    );
    {
        let mut stream = Stream::new_file(file.path(), BUFFER, false)?;
        let written = codec.start_compress(&mut image, &mut stream) != 0
            && codec.encode(&mut stream) != 0
            && codec.end_compress(&mut stream) != 0;
        ensure!(written, "the picture could not be coded");
        stream.flush()?;
    }
    Ok(std::fs::read(file.path())?)
}

fn coder_image(picture: &Gray) -> anyhow::Result<Box<opj_image>> {
    let (w, h) = picture.size();
    let component = opj_image_comptparm {
        dx: 1,
        dy: 1,
        w: u32::try_from(w)?,
        h: u32::try_from(h)?,
        x0: 0,
        y0: 0,
        prec: 8,
        bpp: 8,
        sgnd: 0,
    };
    let mut image =
        opj_image::create(&[component], OPJ_CLRSPC_GRAY).context("no room for the picture")?;
    (image.x1, image.y1) = (component.w, component.h);
    let levels: Vec<i32> = picture.samples().iter().map(|&v| i32::from(v)).collect();
    let plane = image.comps_mut().and_then(|c| c.first_mut());
    ensure!(
        plane.is_some_and(|plane| plane.set_data(&levels)),
        "the coder's picture has another size"
    );
    Ok(image)
}

/// The picture of a code stream.
pub fn decoded(bytes: &[u8]) -> anyhow::Result<Gray> {
    let file = NamedTempFile::new()?;
    std::fs::write(file.path(), bytes)?;
    let mut stream = Stream::new_file(file.path(), BUFFER, true)?;
    let mut codec = Codec::new_decoder(OPJ_CODEC_J2K).context("no JPEG 2000 decoder")?;
    ensure!(
        codec.setup_decoder(&mut opj_dparameters_t::default()) != 0,
        "the decoder refuses its settings"
    );
    let mut image = codec
        .read_header(&mut stream)
        .context("no code stream of JPEG 2000")?;
    ensure!(
        codec.decode(&mut stream, &mut image) != 0 && codec.end_decompress(&mut stream) != 0,
        "the code stream could not be decoded"
    );
    let plane = image
        .comps()
        .and_then(|c| c.first())
        .context("a code stream without a component")?;
    let levels = plane.data().context("a component without samples")?;
    let samples = levels.iter().map(|&v| v.clamp(0, 255) as u8).collect();
    Ok(Gray::from_samples(
        plane.w as usize,
        plane.h as usize,
        samples,
    ))
}
