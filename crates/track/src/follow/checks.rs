//! What is refused before it is looked at.

use crate::error::TrackError;
use crate::view::{EyeView, PixelBox};

/// Least side of a given box, pixels at full size.
const MIN_BOX_PX: (f64, f64) = (12.0, 24.0);

/// Whether a view can be looked at; `name` is the camera's.
pub(crate) fn check_view(view: &EyeView, name: &'static str) -> Result<(), TrackError> {
    if view.pyramid.count() < EyeView::LEVELS {
        return Err(TrackError::Levels {
            found: view.pyramid.count(),
            needed: EyeView::LEVELS,
        });
    }
    let picture = view.pyramid.level(0).size();
    let camera = (view.camera.intrinsics.width, view.camera.intrinsics.height);
    if picture != camera {
        return Err(TrackError::Size { picture, camera });
    }
    if picture.0 < 64 || picture.1 < 64 {
        return Err(TrackError::PictureTooSmall(picture));
    }
    let finite = view
        .base_from_cam
        .to_homogeneous()
        .iter()
        .all(|v| v.is_finite());
    if finite {
        Ok(())
    } else {
        Err(TrackError::Pose(name))
    }
}

/// Whether a given box can be followed in a picture of this size.
///
/// # Errors
/// When the box is no rectangle, lies more than half outside the picture, or is smaller than 12 x 24 pixels.
pub fn check_box(given: &PixelBox, width: usize, height: usize) -> Result<(), TrackError> {
    let b = given;
    let numbers = [b.x, b.y, b.w, b.h].iter().all(|v| v.is_finite());
    if !numbers || b.w <= 0.0 || b.h <= 0.0 {
        return Err(TrackError::BoxShape(*given));
    }
    let across = (b.x + b.w).min(width as f64) - b.x.max(0.0);
    let down = (b.y + b.h).min(height as f64) - b.y.max(0.0);
    if across.max(0.0) * down.max(0.0) < 0.5 * b.w * b.h {
        return Err(TrackError::BoxOutside {
            given: *given,
            width,
            height,
        });
    }
    if b.w < MIN_BOX_PX.0 || b.h < MIN_BOX_PX.1 {
        return Err(TrackError::BoxTooSmall {
            given: *given,
            min_w: MIN_BOX_PX.0,
            min_h: MIN_BOX_PX.1,
        });
    }
    Ok(())
}
