//! `vergence calibrate`: know the cameras, where they stand, and what a motor step is worth.

mod answer;
mod figures;
mod films;
pub(crate) mod lists;
mod live;
mod look;
mod motors;
mod report;
mod table;
mod times;
mod twin;

use std::path::{Path, PathBuf};

use vergence_calib::solve::{
    Calibration, LensModel, MotorState, Settings, Shot, calibrate_fixed, calibrate_head, orient,
};
use vergence_calib::{
    CameraFile, CameraPose, CameraSet, LengthUnit, MachineCalibration, RigCalibration, Target,
};
use vergence_capture::TwinConfig;

use crate::args::Global;
use crate::cameras::LiveChoice;
use crate::fault::{self, Fault};
use crate::output::{self, Format};

use answer::Answer;
use lists::View;
use look::Seen;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Calibrate one camera, a pair, several cameras, or the motorised head, from pictures of a board.

Nothing has to be guessed: focal lengths, lens distortion and where the cameras stand come from the pictures, each with its standard \
deviation. With --motors (where the motors stood for every pair) the machine is calibrated: both lenses, the axes' lines, radians per step, \
backlash; what it gives is good at every vergence, also at those that no picture shows.

Pictures that do not show the board, or fit much worse than the others, are left out and named with the reason. What the pictures tell badly \
is said with the remedy, and where to hold the board next. Pictures that cannot tell the cameras at all are refused.";

const AFTER: &str = "\
Examples:
  vergence calibrate --print charuco:7x5:40mm:30mm:DICT_5X5_100 --out board.svg
  vergence calibrate --target chessboard:9x6:25mm --left left/ --right right/ --out rig.toml --report report
  vergence calibrate --target charuco:7x5:40mm:30mm:DICT_5X5_100 --camera pictures/ --out camera.toml
  vergence calibrate --target aprilgrid:6x6:88mm:0.3 --camera a=cam0/ --camera b=cam1/ --camera c=cam2/ --format json
  vergence calibrate --target chessboard:9x6:25mm --left l/ --right r/ --motors motors.csv --out machine.toml
  vergence calibrate --target charuco:7x5:40mm:30mm:DICT_5X5_100 --left left.mp4 --right right.mp4 --out rig.toml
  vergence calibrate --target chessboard:9x6:25mm --source v4l2 --left /dev/video0 --right /dev/video2 --out rig.toml     cameras as they see now
  vergence calibrate --twin --target chessboard:11x8:30mm --out machine.toml     the simulated rig

Of films and of live cameras (--source) frames are taken where the board is held still at a new place; Ctrl-C says that it is enough.
Boards: chessboard:COLUMNSxROWS:SQUARE (inner corners), charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY[:legacy][:inverted] (squares), \
aprilgrid:COLUMNSxROWS:TAG:SPACING, or Kalibr's target file. Pictures of several cameras belong together by the number in their names, else by their order.
--times is a table with the columns time_left_s, time_right_s (time_NAME_s of --camera NAME=...) and a row for every pair.
--motors is a table with the columns left, right (file names), place (which stand of the board), pan_steps, tilt_steps, left_steps, right_steps and, \
for the backlash, pan_approach ... (+1 came from below, -1 from above).
Exit code 0: calibrated; 1: failed; 2: the call or its pictures cannot be used. docs/reference-calibrate.md documents every field.";

/// Lens models as they are typed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum LensChoice {
    /// Brown–Conrady, k1 k2 p1 p2 k3.
    #[default]
    Brown5,
    /// Brown–Conrady, rational: k1 k2 p1 p2 k3 k4 k5 k6.
    Brown8,
    /// Kannala–Brandt: lenses wider than about 110 degrees.
    Fisheye,
}

impl LensChoice {
    fn model(self) -> LensModel {
        match self {
            Self::Brown5 => LensModel::BrownConrady5,
            Self::Brown8 => LensModel::BrownConrady8,
            Self::Fisheye => LensModel::KannalaBrandt,
        }
    }
}

/// Formats of other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ExportFormat {
    /// Our own fields as JSON.
    Json,
    /// OpenCV's FileStorage, YAML.
    OpencvYaml,
    /// OpenCV's FileStorage, XML.
    OpencvXml,
    /// ROS camera_info, a file for each camera.
    Ros,
    /// Kalibr's camera chain.
    Kalibr,
}

impl ExportFormat {
    fn format(self) -> vergence_calib::Format {
        use vergence_calib::Format;
        match self {
            Self::Json => Format::Json,
            Self::OpencvYaml => Format::OpenCvYaml,
            Self::OpencvXml => Format::OpenCvXml,
            Self::Ros => Format::Ros,
            Self::Kalibr => Format::Kalibr,
        }
    }
}

/// Flags of `vergence calibrate`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct CalibrateArgs {
    /// The board, as below or a file of Kalibr.
    #[arg(long, value_name = "BOARD", required_unless_present = "print")]
    target: Option<String>,
    /// The left camera's pictures, a folder of them, or a film.
    #[arg(long, value_name = "FILES", num_args = 1.., requires = "right", help_heading = "Pictures")]
    left: Vec<PathBuf>,
    /// The right camera's.
    #[arg(long, value_name = "FILES", num_args = 1.., requires = "left", help_heading = "Pictures")]
    right: Vec<PathBuf>,
    /// A camera's pictures: a folder, a file or a film, NAME=FOLDER for several cameras; may be repeated.
    #[arg(long, value_name = "[NAME=]FOLDER", conflicts_with_all = ["left", "right"], help_heading = "Pictures")]
    camera: Vec<String>,
    /// Where the motors stood for every pair (CSV): calibrates the machine.
    #[arg(
        long,
        value_name = "FILE",
        requires = "left",
        help_heading = "Pictures"
    )]
    motors: Option<PathBuf>,
    /// When every picture was taken (CSV, seconds): boards that moved are followed, late cameras found out.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "motors",
        help_heading = "Pictures"
    )]
    times: Option<PathBuf>,
    /// Calibrate live cameras: --left and --right (or --device) are devices or URLs, pairs are made by time.
    #[arg(long, value_enum, value_name = "KIND", conflicts_with_all = ["camera", "motors", "times"], help_heading = "Cameras")]
    source: Option<LiveChoice>,
    /// Size of a video device's pictures [default: 640x480].
    #[arg(
        long,
        value_name = "WxH",
        requires = "source",
        help_heading = "Cameras"
    )]
    size: Option<String>,
    #[command(flatten)]
    cameras_live: crate::run::live::CameraFlags,
    /// Let the simulated rig look at the board instead, its motors going from place to place.
    #[arg(long, conflicts_with_all = ["left", "right", "camera", "motors", "times", "source"], help_heading = "Pictures")]
    twin: bool,
    /// Seed of the twin's boards, motions and noise.
    #[arg(
        long,
        default_value_t = 1,
        requires = "twin",
        help_heading = "Pictures"
    )]
    seed: u64,
    /// Stands of the board before the twin.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 14,
        requires = "twin",
        help_heading = "Pictures"
    )]
    places: usize,
    /// States of the twin's motors at each stand.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 9,
        requires = "twin",
        help_heading = "Pictures"
    )]
    states: usize,
    /// Lens model.
    #[arg(long, value_enum, default_value_t)]
    lens: LensChoice,
    /// Keep pictures that fit much worse than the others.
    #[arg(long)]
    keep_all: bool,
    /// The calibration file to write (with --print the drawing).
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write the calibration for other programs, too, into the folder of --export.
    #[arg(long = "as", value_enum, value_name = "FORMAT", requires = "export")]
    format_of_export: Option<ExportFormat>,
    /// Folder for --as; it must be there.
    #[arg(long, value_name = "DIR", requires = "format_of_export")]
    export: Option<PathBuf>,
    /// Unit of the translations in the files of --as (OpenCV's only): m, cm, mm, in.
    #[arg(long, value_name = "UNIT", value_parser = crate::calibration::unit, requires = "export")]
    unit: Option<LengthUnit>,
    /// Make a page about the calibration in this folder: residuals, coverage, uncertainty, what is weak and what to do.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Draw the board to scale (SVG) instead of calibrating.
    #[arg(long, value_name = "BOARD", conflicts_with_all = ["target", "left", "camera", "report"])]
    print: Option<String>,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Calibrate.
pub(crate) fn run(global: &Global, args: &CalibrateArgs) -> anyhow::Result<()> {
    if let Some(text) = &args.print {
        return print_board(text, args.out.as_deref());
    }
    let target = board(args.target.as_deref().unwrap_or_default())?;
    lists::check_out(args.out.as_deref())?;
    check_export(args)?;
    let pictures = match args.twin {
        true => {
            args.cameras_live.refuse("the twin")?;
            Pictures::of_twin(&crate::twin::config(&global.settings(&[])?)?, args, &target)?
        }
        false => Pictures::of_files(args, &target)?,
    };
    if args.unit.is_some() && pictures.names.len() != 2 {
        let fault = fault::usage("--unit is given, but no file of a pair is written");
        return Err(fault.hint("leave --unit out").into());
    }
    let mut work = Work::new(&pictures);
    work.orient(args, &target)?;
    let calibration = work.calibrated(args)?;
    if pictures.times.is_some() && calibration.delays.is_empty() {
        output::say(
            "--times tell nothing here: it takes several cameras, each of which saw the board at three moments of the first camera or more",
        );
    }
    let saved = Saved::new(&calibration, &pictures.names)?;
    let mut answer = Answer::new(&work, &calibration, &target);
    if let Some(config) = &pictures.twin {
        answer.against_truth = Some(twin::against(config, &calibration, args.seed));
    }
    if let Some(dir) = &args.report {
        report::write(dir, &work, &calibration, &answer, &target)?;
    }
    if let Some(path) = &args.out {
        saved.write(path)?;
    }
    if let (Some(format), Some(folder)) = (args.format_of_export, &args.export) {
        for path in saved.export(folder, format, args.unit)? {
            output::say(&format!("wrote {}", path.display()));
        }
    }
    match args.format {
        Format::Text => output::print(&answer.text())?,
        Format::Json => output::print_json(&answer)?,
    }
    if let Some(path) = &args.out {
        output::say(&format!("wrote {}", path.display()));
    }
    if let Some(dir) = &args.report {
        output::say(&format!("wrote {}", dir.join(report::PAGE).display()));
    }
    Ok(())
}

/// What can be said of `--as`, `--export` and `--unit` before anything is computed.
fn check_export(args: &CalibrateArgs) -> Result<(), Fault> {
    if let Some(folder) = args.export.as_ref().filter(|folder| !folder.is_dir()) {
        let fault = format!("--export {}: there is no such folder", folder.display());
        return Err(fault::usage(fault));
    }
    let Some((format, _)) = args.format_of_export.zip(args.unit) else {
        return Ok(());
    };
    if !matches!(format, ExportFormat::OpencvYaml | ExportFormat::OpencvXml) {
        return Err(fault::usage(
            "--unit is given, but only OpenCV's files may be in another unit than metres",
        )
        .hint("leave --unit out, or write --as opencv-yaml"));
    }
    Ok(())
}

/// A board from its text, or from a file of Kalibr.
fn board(text: &str) -> Result<Target, Fault> {
    let hint = "for example chessboard:9x6:25mm, charuco:7x5:40mm:30mm:DICT_5X5_100 or aprilgrid:6x6:88mm:0.3";
    let path = Path::new(text);
    let described = match path.is_file() {
        true => output::read_text(path, "board file", 1 << 20)
            .map_err(|e| fault::usage(e.to_string()))
            .and_then(|yaml| {
                Target::from_kalibr_yaml(&yaml).map_err(|e| fault::usage(e.to_string()))
            })?,
        false => Target::parse(text).map_err(|e| fault::usage(e.to_string()).hint(hint))?,
    };
    Ok(described)
}

fn print_board(text: &str, out: Option<&Path>) -> anyhow::Result<()> {
    let svg = board(text)?.svg();
    match out {
        Some(path) => {
            output::write_file(path, svg.as_bytes())?;
            output::say(&format!(
                "wrote {}; print it without scaling, and measure a square afterwards",
                path.display()
            ));
        }
        None => output::print(&svg)?,
    }
    Ok(())
}

/// Pictures and what was seen in them.
struct Pictures {
    names: Vec<String>,
    views: Vec<View>,
    seen: Vec<Seen>,
    /// Of every view: stand of the board and state of the motors, where these are known.
    states: Option<Vec<(usize, MotorState)>>,
    /// When every view was taken, s, where that is known.
    times: Option<Vec<f64>>,
    /// The twin that took them.
    twin: Option<TwinConfig>,
}

impl Pictures {
    fn of_files(args: &CalibrateArgs, target: &Target) -> anyhow::Result<Self> {
        if let Some(choice) = args.source {
            let taken = live::taken(choice, args, target)?;
            return Ok(Self {
                names: ["left", "right"].map(str::to_owned).into(),
                views: taken.views,
                seen: taken.seen,
                states: None,
                times: None,
                twin: None,
            });
        }
        args.cameras_live.refuse("pictures and films")?;
        if let Some((names, films)) = lists::films(&args.left, &args.right, &args.camera)? {
            if args.motors.is_some() || args.times.is_some() {
                let flag = if args.motors.is_some() {
                    "--motors"
                } else {
                    "--times"
                };
                return Err(fault::usage(format!(
                    "{flag} is about pictures, and films were given"
                ))
                .hint("give pictures, or leave it out")
                .into());
            }
            let taken = films::of_films(&films, target)?;
            return Ok(Self {
                names,
                views: taken.views,
                seen: taken.seen,
                states: None,
                times: None,
                twin: None,
            });
        }
        let (names, mut views) = lists::views(&args.left, &args.right, &args.camera)?;
        let log = args
            .motors
            .as_deref()
            .map(|path| motors::Log::read(path, &views))
            .transpose()?;
        let times = (args.times.as_deref())
            .map(|path| times::read(path, &names, &views))
            .transpose()?;
        let seen = look::at(&mut views, target, names.len())?;
        Ok(Self {
            states: log.map(|log| views.iter().map(|view| log.of(view)).collect()),
            times,
            names,
            views,
            seen,
            twin: None,
        })
    }

    fn of_twin(config: &TwinConfig, args: &CalibrateArgs, target: &Target) -> anyhow::Result<Self> {
        const MOST: usize = 200;
        for (flag, value) in [("--places", args.places), ("--states", args.states)] {
            if !(1..=MOST).contains(&value) {
                return Err(
                    fault::usage(format!("{flag} {value}: it must lie in 1..={MOST}")).into(),
                );
            }
        }
        let session = twin::Session {
            places: args.places,
            states: args.states,
            seed: args.seed,
        };
        let taken = twin::taken(config, target, &session)?;
        Ok(Self {
            names: vec!["left".to_owned(), "right".to_owned()],
            views: taken.views,
            seen: taken.seen,
            states: Some(taken.states),
            times: None,
            twin: Some(config.clone()),
        })
    }
}

/// All that calibration works on.
pub(crate) struct Work<'a> {
    names: &'a [String],
    views: &'a [View],
    /// What was seen in each view.
    seen: &'a [Seen],
    /// Shots of those views that show the board, with the place of each view.
    shots: Vec<Shot>,
    view_of_shot: Vec<usize>,
    sizes: Vec<(usize, usize)>,
    machine: bool,
}

impl<'a> Work<'a> {
    fn new(pictures: &'a Pictures) -> Self {
        let (names, views, seen) = (&pictures.names, &pictures.views, &pictures.seen);
        let mut shots = Vec::new();
        let mut view_of_shot = Vec::new();
        for (i, (view, seen)) in views.iter().zip(seen).enumerate() {
            let Seen::Board(sightings) = seen else {
                continue;
            };
            let (placement, state) = match &pictures.states {
                Some(states) => states[i],
                None => (view.group, MotorState::default()),
            };
            view_of_shot.push(i);
            shots.push(Shot {
                camera: view.camera,
                placement,
                motors: state,
                sightings: sightings.clone(),
                time_s: pictures.times.as_ref().map(|times| times[i]),
            });
        }
        let size = |camera: usize| {
            views
                .iter()
                .find(|v| v.camera == camera)
                .map_or((0, 0), |v| v.size)
        };
        Self {
            names,
            views,
            seen,
            shots,
            view_of_shot,
            sizes: (0..names.len()).map(size).collect(),
            machine: pictures.states.is_some(),
        }
    }

    /// Let both cameras read a board that looks the same after a turn the same way round.
    fn orient(&mut self, args: &CalibrateArgs, target: &Target) -> anyhow::Result<()> {
        let Target::Chessboard(board) = target else {
            return Ok(());
        };
        let settings = Settings::new(args.lens.model(), &self.sizes);
        let turned = orient(&mut self.shots, board, &settings).map_err(|e| self.explained(&e))?;
        if turned > 0 {
            output::say(&format!(
                "the board looks the same after a turn: in {turned} pictures it is read the other way round, so that both cameras agree"
            ));
        }
        Ok(())
    }

    fn calibrated(&self, args: &CalibrateArgs) -> anyhow::Result<Calibration> {
        let settings = Settings {
            reject: !args.keep_all,
            ..Settings::new(args.lens.model(), &self.sizes)
        };
        // Axes that no picture tells keep the step of a usual drive: 0.01 degrees.
        const USUAL_STEP_RAD: f64 = 1.745e-4;
        let solved = match self.machine {
            true => calibrate_head(&self.shots, &settings, [USUAL_STEP_RAD; 4]),
            false => calibrate_fixed(&self.shots, &settings),
        };
        let calibration = solved.map_err(|e| self.explained(&e))?;
        self.check_sides(&calibration)?;
        Ok(calibration)
    }

    /// The error with the cameras' names, and what was seen in the pictures that show no board.
    fn explained(&self, error: &vergence_calib::CalibError) -> Fault {
        let mut text = error.to_string();
        for (i, name) in self.names.iter().enumerate() {
            text = text.replace(&format!("camera {i}"), &format!("camera {name}"));
        }
        let unseen = self.views.iter().zip(self.seen).find_map(|(v, s)| match s {
            Seen::Nothing(reason) => Some(format!("{}: {reason}", v.path.display())),
            Seen::Board(_) => None,
        });
        let fault = fault::usage(text);
        match unseen {
            Some(reason) => fault.hint(format!("pictures without the board are no help; {reason}")),
            None => fault,
        }
    }

    /// Left must be left: x of the right lens in the left camera's frame is positive.
    fn check_sides(&self, calibration: &Calibration) -> Result<(), Fault> {
        let sides = self.names.len() == 2 && self.names[0] == "left";
        let Some(right_from_left) = calibration.right_from_left().filter(|_| sides) else {
            return Ok(());
        };
        let lens_in_left = right_from_left.inverse().translation.vector;
        if lens_in_left.x < 0.0 && lens_in_left.x.abs() > 0.5 * lens_in_left.norm() {
            return Err(fault::usage(format!(
                "left and right are exchanged: the camera called right stands {:.0} mm to the left of the other",
                -1e3 * lens_in_left.x
            ))
            .hint("give the pictures of --left as --right and the other way round"));
        }
        Ok(())
    }
}

/// What is written with --out: a machine, a pair, or cameras.
enum Saved {
    Machine(Box<MachineCalibration>),
    Pair(Box<RigCalibration>),
    Cameras(CameraSet),
}

impl Saved {
    fn new(calibration: &Calibration, names: &[String]) -> anyhow::Result<Self> {
        let home = MotorState::default();
        let poses: Vec<CameraPose> = calibration
            .cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| CameraPose {
                name: names[i].clone(),
                camera: *camera,
                rig_from_cam: calibration.mechanism.rig_from_cam(i, &home),
            })
            .collect();
        if let [left, right] = names {
            let both = [left.clone(), right.clone()];
            if let Some(machine) = MachineCalibration::from_solved(calibration, both) {
                return Ok(Self::Machine(Box::new(machine)));
            }
        }
        if let [left, right] = poses.as_slice() {
            let pair = RigCalibration::from_poses(left.clone(), right.clone());
            let mut pair = pair.map_err(|e| fault::usage(e.to_string()))?;
            pair.notes.extend(notes(calibration, names));
            return Ok(Self::Pair(Box::new(pair)));
        }
        let alone = poses.len() == 1;
        Ok(Self::Cameras(CameraSet {
            cameras: poses
                .into_iter()
                .map(|pose| CameraFile {
                    name: pose.name,
                    camera: pose.camera,
                    rig_from_cam: (!alone).then_some(pose.rig_from_cam),
                })
                .collect(),
            notes: notes(calibration, names),
        }))
    }

    /// For other programs. A machine has no place in their files: its pair at home is written.
    fn export(
        &self,
        folder: &Path,
        format: ExportFormat,
        unit: Option<LengthUnit>,
    ) -> anyhow::Result<Vec<PathBuf>> {
        let format = format.format();
        let stated = unit.unwrap_or(LengthUnit::Metre);
        let written = match self {
            Self::Machine(machine) => machine
                .at(&MotorState::default())
                .and_then(|pair| pair.write_as_in(folder, format, stated)),
            Self::Pair(pair) => pair.write_as_in(folder, format, stated),
            Self::Cameras(cameras) => cameras.write_as(folder, format),
        };
        Ok(written.map_err(|e| fault::failed(e.to_string()))?)
    }

    fn write(&self, path: &Path) -> anyhow::Result<()> {
        match self {
            Self::Machine(machine) => machine
                .write(path)
                .map_err(|e| fault::failed(e.to_string()))?,
            Self::Pair(pair) => pair.write(path).map_err(|e| fault::failed(e.to_string()))?,
            Self::Cameras(cameras) => {
                let text = cameras.to_text(vergence_calib::Format::Toml);
                let text = text.map_err(|e| fault::failed(e.to_string()))?;
                output::write_file(path, text[0].text.as_bytes())?;
            }
        }
        Ok(())
    }
}

/// How good it is and what is weak, for the file.
fn notes(calibration: &Calibration, names: &[String]) -> Vec<String> {
    let weak = answer::weaknesses(calibration, names);
    std::iter::once(format!(
        "calibrated with {:.3} px RMS over {} corners",
        calibration.rms_px, calibration.corner_count
    ))
    .chain(
        weak.into_iter()
            .map(|w| format!("{}; {}", w.what, w.remedy)),
    )
    .collect()
}
