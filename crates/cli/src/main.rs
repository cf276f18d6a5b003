//! `vergence`: plans, runs and grades stereo camera arrays.
//!
//! `main` turns what a command returned into an exit code; [`run()`] chooses the command. Data goes to stdout, talk to
//! stderr; 0 is success, 1 a failure, 2 a call that cannot be answered as it was typed.

mod args;
mod calibrate;
mod calibration;
mod cameras;
mod config;
mod depth;
mod doctor;
mod export;
mod fault;
mod figure;
mod grade;
mod health;
mod home;
mod info;
mod jog;
mod model;
mod motors;
mod moving;
mod output;
mod plan;
mod project;
mod rectify;
mod replay;
mod rig;
mod run;
mod settings;
mod twin;

use std::process::ExitCode;

use clap::Parser;

use args::{Args, Command};

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fault::report(&error),
    }
}

/// Run the command that was typed.
fn run(args: &Args) -> anyhow::Result<()> {
    match &args.command {
        Command::Plan(plan) => plan::run(&args.global, plan),
        Command::Project(project) => project::run(&args.global, project),
        Command::Run(args_of_run) => run::run(&args.global, args_of_run),
        Command::Depth(args_of_depth) => depth::run(&args.global, args_of_depth),
        Command::Grade(args_of_grade) => grade::run(&args.global, args_of_grade),
        Command::Calibrate(args_of_calibrate) => calibrate::run(&args.global, args_of_calibrate),
        Command::Health(args_of_health) => health::run(args_of_health),
        Command::Info(info) => info::run(info),
        Command::Export(export) => export::run(export),
        Command::Replay(replay) => replay::run(replay),
        Command::Doctor(args_of_doctor) => doctor::run(&args.global, args_of_doctor),
        Command::Home(args_of_home) => home::run(&args.global, args_of_home),
        Command::Jog(args_of_jog) => jog::run(&args.global, args_of_jog),
        Command::Model(model) => model::run(model),
        Command::Rectify(rectify) => rectify::run(rectify),
        Command::Config(config) => config::run(&args.global, config),
    }
}
