//! Hostile bytes, both ways: nothing panics, what is garbage is counted, and the next good line is read as what it is.

use std::io;

use proptest::prelude::*;
use vergence_control::grbl::lines::{LINE_MAX, LineReader};
use vergence_control::grbl::protocol::{Line, parse};
use vergence_control::grbl::{
    GrblConfig, GrblDrive, Port, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};
use vergence_control::{AxisName, AxisState, Drive, HeadConfig};

/// A port that says what it is told to.
struct Parrot(Vec<u8>);

impl Port for Parrot {
    fn name(&self) -> &str {
        "parrot"
    }

    fn read(&mut self, into: &mut [u8], _now_s: f64) -> io::Result<usize> {
        let n = into.len().min(self.0.len()).min(97);
        into[..n].copy_from_slice(&self.0[..n]);
        self.0.drain(..n);
        Ok(n)
    }

    fn write(&mut self, bytes: &[u8], _now_s: f64) -> io::Result<usize> {
        Ok(bytes.len().min(5))
    }

    fn open(&mut self, _now_s: f64) -> io::Result<()> {
        Ok(())
    }

    fn baud(&self) -> u32 {
        115_200
    }
}

/// Bytes as they might come: noise, and pieces of what controllers say.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..40),
        prop::sample::select(vec![
            "ok\r\n",
            "error:9\n",
            "ALARM:1\n",
            "<Idle|MPos:0,0,0,0|FS:0,0>\n",
            "<Jog|MPos:1e9,2,3,4|",
            "Grbl 1.1h ['$' for help]\r\n",
            "[OPT:V,15,128]\n",
            "[AXS:4:XYZA]\n",
            "[AXS:26:ABCDEFGHIJKLMNOPQRSTUVWXYZ]\n",
            "[AXS:9:BCUVWXYZA]\n",
            "$100=",
            "177.778\n",
            "$131=99999999999999999999\n",
            "[VER:",
            "]",
            ">",
            "<",
            "<Idle|MPos:0,0,0,0|WCO:9,9,9,9>\n",
            "<Hold:0|WPos:0,0,0>\n",
            "[OPT:,65535,0]\n",
        ])
        .prop_map(|s| s.as_bytes().to_vec()),
    ];
    prop::collection::vec(piece, 0..60).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Lines are bounded, and after any noise a line end is enough to read on.
    #[test]
    fn lines_come_back_into_step(noise in prop::collection::vec(any::<u8>(), 0..2000)) {
        let mut reader = LineReader::new();
        for byte in noise {
            if let Some(line) = reader.push(byte) {
                prop_assert!(!line.is_empty() && line.len() <= LINE_MAX);
                let _ = parse(&line);
            }
        }
        let _ = reader.push(b'\n');
        let lines: Vec<String> = b"error:15\r\n".iter().filter_map(|b| reader.push(*b)).collect();
        prop_assert_eq!(lines.len(), 1);
        prop_assert_eq!(parse(&lines[0]), Some(Line::Error(15)));
    }

    /// A status report that has one character changed either still parses to finite numbers or not at all.
    #[test]
    fn one_changed_character(at in 0_usize..60, byte in 32_u8..127) {
        let mut line = b"<Jog|MPos:-1.000,2.500,0.000,-0.250|Bf:12,96|FS:600,0>".to_vec();
        let at = at % line.len();
        line[at] = byte;
        let text = String::from_utf8(line).unwrap();
        if let Some(Line::Status(report)) = parse(&text) {
            prop_assert!(report.feed.is_none_or(f64::is_finite));
        }
    }

    /// The driver survives whatever a port says; it never takes the axes for homed, as nobody has homed them.
    #[test]
    fn the_driver_survives_anything(said in bytes()) {
        let port = Box::new(Parrot(said));
        let mut drive = GrblDrive::new(GrblConfig::default(), &HeadConfig::default(), port, 0.0).unwrap();
        for i in 0..200 {
            let now_s = f64::from(i) * 0.01;
            drive.update(now_s);
            if i == 100 {
                let _ = drive.clear(now_s);
            }
            prop_assert!(drive.states().iter().all(|s| matches!(s, AxisState::Unhomed | AxisState::Fault)));
            let _ = drive.reading(AxisName::Tilt, now_s);
        }
        prop_assert!(drive.take_events().len() <= 64);
    }

    /// The simulated controller survives whatever is written to it, and answers a status request afterwards.
    #[test]
    fn the_simulated_controller_survives_anything(written in bytes()) {
        let config = SimulatedGrblConfig::for_rig(&HeadConfig::default());
        let grbl = SharedGrbl::new(SimulatedGrbl::new(config, 0.0));
        let mut now_s = 0.1;
        for piece in written.chunks(50) {
            grbl.lock().receive(piece, now_s);
            now_s += 0.003;
        }
        grbl.lock().advance_to(now_s + 0.5);
        grbl.lock().receive(b"\x18\n", now_s + 0.5);
        let mut heard = vec![0; 65536];
        let mut grbl = grbl.lock();
        grbl.advance_to(now_s + 5.0);
        let _ = grbl.send(&mut heard, now_s + 5.0);
        grbl.receive(b"?", now_s + 5.0);
        let n = grbl.send(&mut heard, now_s + 5.1);
        let text = String::from_utf8_lossy(&heard[..n]);
        prop_assert!(text.contains('<'), "{text}");
    }
}
