//! What can be typed: the flags of every command and their manual pages.

use std::path::PathBuf;

use clap::{Parser, Subcommand};

use crate::calibrate::{self, CalibrateArgs};
use crate::config::{self, ConfigArgs};
use crate::depth::{self, DepthArgs};
use crate::doctor::{self, DoctorArgs};
use crate::export::{self, ExportArgs};
use crate::fault;
use crate::grade::{self, GradeArgs};
use crate::health::{self, HealthArgs};
use crate::home::{self, HomeArgs};
use crate::info::{self, InfoArgs};
use crate::jog::{self, JogArgs};
use crate::model::{self, ModelArgs};
use crate::plan::{self, PlanArgs};
use crate::project::{self, ProjectArgs};
use crate::rectify::{self, RectifyArgs};
use crate::replay::{self, ReplayArgs};
use crate::run::{self, RunArgs};
use crate::settings::{Override, Settings};

const ABOUT: &str = "\
Vergence plans, runs and grades stereo camera arrays.

One model of the geometry stands under everything: two cameras (parallel, converged or shifted), a screen and a viewer. \
Without any settings it answers for the rig of Yang, Xu, Lv and Song (Sensors 2016, 16(3), 421): 70 mm between the \
cameras, 6.5 mm lenses, 1/3-inch sensors of 1024x768 pixels, a screen that shows the picture 50 times as large, seen from 0.7 m \
by eyes 65 mm apart.";

const AFTER: &str = "\
Examples:
  vergence run                               a walking person, held at zero parallax
  vergence plan                              the paper's rig, 1 m to 10 m
  vergence plan --base 100mm --near 2m       another rig
  vergence project --mode converged --convergence 1m --point 0.4,0.3,1
  vergence grade --left l.png --right r.png  what is wrong with a pair
  vergence depth --left l.png --right r.png --rectified --out depth
  vergence config > rig.toml                 a settings file to edit
  vergence --config rig.toml plan

Units: lengths take m, mm, cm, um, in (bare number: metres); angles deg, rad, mrad, arcmin, arcsec (bare: degrees); \
times s, ms, us, min (bare: seconds).
Settings: flags win over VERGENCE_<SECTION>_<KEY> in the environment, that over the file of --config, that over defaults; \
`vergence config` prints the effective ones and where each came from.
Output: data on stdout, talk on stderr. Exit code 0: done; 1: failed; 2: the call cannot be answered as typed.";

/// The command line.
#[derive(Debug, Parser)]
#[command(name = "vergence", version, about = ABOUT, after_help = AFTER, max_term_width = 100, subcommand_required = true, arg_required_else_help = true)]
pub(crate) struct Args {
    /// Flags of every command.
    #[command(flatten)]
    pub(crate) global: Global,
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Flags of every command.
#[derive(Debug, clap::Args)]
pub(crate) struct Global {
    /// Settings file (TOML); see `vergence config`.
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        env = "VERGENCE_CONFIG",
        help_heading = "Settings"
    )]
    pub(crate) config: Option<PathBuf>,
    /// Set any setting: --set camera.fps=25. May be repeated.
    #[arg(
        long,
        global = true,
        value_name = "SECTION.KEY=VALUE",
        help_heading = "Settings"
    )]
    pub(crate) set: Vec<String>,
}

/// The commands. What each does is its page's text, said here: a doc comment would take the place of `long_about`.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    #[command(about = "Say which camera mode suits which distances, and why", long_about = plan::LONG)]
    Plan(PlanArgs),
    #[command(about = "Show where points of the scene fall in both pictures and where a viewer sees them", long_about = project::LONG)]
    Project(ProjectArgs),
    #[command(about = "Hold a walking person at zero parallax, on the simulated rig or on recorded pairs", long_about = run::LONG)]
    Run(Box<RunArgs>),
    #[command(about = "Say what is in a recording, and whether it is whole", long_about = info::LONG)]
    Info(InfoArgs),
    #[command(about = "Write a recording out as pictures, CSV, Parquet and video", long_about = export::LONG)]
    Export(ExportArgs),
    #[command(about = "Feed a recording back through the loop and compare", long_about = replay::LONG)]
    Replay(ReplayArgs),
    #[command(about = "Measure the depth of every pixel of a pair: disparities, metres, a point cloud", long_about = depth::LONG)]
    Depth(Box<DepthArgs>),
    #[command(about = "Grade a picture or a stereo pair: how good it is, and what is wrong with it", long_about = grade::LONG)]
    Grade(Box<GradeArgs>),
    #[command(about = "Know the cameras: lenses, where they stand, what a motor step is worth, and how well", long_about = calibrate::LONG)]
    Calibrate(Box<CalibrateArgs>),
    #[command(about = "Rectify stereo pairs: the same rows in both, without lens distortion", long_about = rectify::LONG)]
    Rectify(Box<RectifyArgs>),
    #[command(about = "Say how well a rig still fits its calibration, from pictures of any scene", long_about = health::LONG)]
    Health(Box<HealthArgs>),
    #[command(about = "Say what cameras, motors and programs are there, what is wrong, and what to do next", long_about = doctor::LONG)]
    Doctor(DoctorArgs),
    #[command(about = "Home all axes: find their zero", long_about = home::LONG)]
    Home(HomeArgs),
    #[command(about = "Turn one axis by hand", long_about = jog::LONG)]
    Jog(JogArgs),
    #[command(about = "List, show, import and remove the models that pictures are graded with", long_about = model::LONG)]
    Model(ModelArgs),
    #[command(about = "Print the effective settings with units, meanings and origins", long_about = config::LONG)]
    Config(ConfigArgs),
}

impl Global {
    /// The settings: defaults, file, environment, `--set`, then the flags of the command.
    pub(crate) fn settings(&self, flags: &[Override]) -> anyhow::Result<Settings> {
        let mut overrides = Vec::new();
        for text in &self.set {
            let (path, value) = text.split_once('=').ok_or_else(|| {
                fault::usage(format!("--set '{text}' has no '='"))
                    .hint("write --set section.key=value, for example --set camera.fps=25")
            })?;
            overrides.push(Override {
                path: path.trim().to_owned(),
                flag: format!("--set {}", path.trim()),
                text: value.trim().to_owned(),
            });
        }
        overrides.extend_from_slice(flags);
        // Variables that are not Unicode cannot be settings of ours.
        let environment = std::env::vars_os()
            .filter_map(|(n, v)| Some((n.into_string().ok()?, v.into_string().ok()?)));
        Settings::load(self.config.as_deref(), environment, &overrides)
    }
}

#[cfg(test)]
mod tests {
    //! The command line is consistent with itself.
    use clap::CommandFactory;

    #[test]
    fn clap_accepts_the_definition() {
        super::Args::command().debug_assert();
    }
}
