//! `cargo xtask`: the gate (`ci`) and the benchmarks against named peers (`bench-vs`).
fn main() {}
