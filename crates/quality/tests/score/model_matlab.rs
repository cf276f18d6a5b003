//! Proves of the reader of MATLAB files, on small files that the test writes itself: a model laid out as the release's is imported number
//! for number, plain and compressed, sparse and full; what is not that model is refused with a sentence that says what is missing; no
//! damage, no lie about a size and no bomb makes it panic or take memory without bound.

use crate::small;
use proptest::prelude::*;
use vergence_quality::model::matlab;
use vergence_quality::model::{Regressor, Scaling, Support};
use vergence_quality::{FEATURE_COUNT, Features, Model};

use crate::matlab_file::{Array, column, element, file, header, matrix, row, tag};

/// Names and contents, in the order of the file.
type Variables = Vec<(&'static str, Array)>;

fn support(support: &Support, sparse: bool) -> Array {
    let n = support.vectors.len();
    let values = (0..FEATURE_COUNT)
        .flat_map(|c| support.vectors.iter().map(move |v| v[c]))
        .collect();
    match sparse {
        true => Array::Sparse([n, FEATURE_COUNT], values),
        false => Array::Full([n, FEATURE_COUNT], values),
    }
}

fn rows(rows: &[&Features]) -> Array {
    let values = (0..FEATURE_COUNT).flat_map(|c| rows.iter().map(move |r| r[c]));
    Array::Full([rows.len(), FEATURE_COUNT], values.collect())
}

fn regressor(r: &Regressor, sparse: bool) -> Array {
    Array::Struct(vec![
        ("Parameters", column(&[4.0, 2.0, 3.0, r.support.gamma, 0.0])),
        ("nr_class", column(&[2.0])),
        ("totalSV", column(&[r.support.vectors.len() as f64])),
        ("rho", column(&[r.rho])),
        ("Label", Array::Full([0, 0], vec![])),
        ("ProbA", Array::Full([0, 0], vec![])),
        ("sv_coef", column(&r.coefficients)),
        ("SVs", support(&r.support, sparse)),
    ])
}

/// The variables of the release for a model.
fn variables(model: &Model, sparse: bool) -> Variables {
    let c = &model.classifier;
    let n = c.support.vectors.len();
    let coefficients = (0..4).flat_map(|k| c.coefficients.iter().map(move |row| row[k]));
    let class = Array::Struct(vec![
        ("Parameters", column(&[0.0, 2.0, 3.0, c.support.gamma, 0.0])),
        ("nr_class", column(&[5.0])),
        ("totalSV", column(&[n as f64])),
        ("rho", column(&c.rho)),
        ("Label", column(&c.labels.map(|l| l.index() as f64 + 1.0))),
        ("ProbA", column(&c.prob_a)),
        ("ProbB", column(&c.prob_b)),
        ("nSV", column(&c.counts.map(|n| n as f64))),
        ("sv_coef", Array::Full([n, 4], coefficients.collect())),
        ("SVs", support(&c.support, sparse)),
    ]);
    let cells = model.regressors.iter().map(|r| regressor(r, sparse));
    let of =
        |f: fn(&Scaling) -> &Features| rows(&model.regressors.each_ref().map(|r| f(&r.scaling)));
    vec![
        ("remarks", Array::Text("other variables are passed over")),
        ("a_class", row(&c.scaling.a)),
        ("b_class", row(&c.scaling.b)),
        ("a_reg", of(|s| &s.a)),
        ("b_reg", of(|s| &s.b)),
        ("model_class", class),
        ("model_reg", Array::Cell([1, 5], cells.collect())),
    ]
}

fn same_numbers(a: &Model, b: &Model) -> bool {
    a.classifier == b.classifier && a.regressors == b.regressors
}

#[test]
fn a_model_is_imported_number_for_number() {
    for unit in [1.0, 3e-5, 700.0] {
        let model = small::model(unit);
        for (sparse, compressed) in [(true, true), (true, false), (false, true), (false, false)] {
            let bytes = file(&variables(&model, sparse), compressed);
            let read = Model::from_matlab(&bytes, "mine").unwrap();
            assert!(same_numbers(&read, &model), "{sparse} {compressed}");
            assert_eq!(read.name, "mine");
            assert!(read.licence.contains("The University of Texas at Austin"));
        }
    }
}

#[test]
fn another_file_is_refused_with_what_is_missing() {
    let refusal = |change: &dyn Fn(&mut Variables)| {
        let mut all = variables(&small::model(1.0), true);
        change(&mut all);
        let error = Model::from_matlab(&file(&all, true), "x").unwrap_err();
        error.to_string()
    };
    let without = |name: &'static str| refusal(&move |all| all.retain(|(n, _)| *n != name));
    let field = |name: &'static str, field: &'static str, to: fn() -> Option<Array>| {
        refusal(&move |all| {
            let (_, array) = all.iter_mut().find(|(n, _)| *n == name).unwrap();
            let array = match array {
                Array::Cell(_, cells) => &mut cells[1],
                other => other,
            };
            let Array::Struct(fields) = array else {
                panic!("{name} is no structure")
            };
            fields.retain(|(n, _)| *n != field);
            fields.extend(to().map(|a| (field, a)));
        })
    };
    for (found, expected) in [
        (without("a_class"), "it has no variable a_class"),
        (without("model_reg"), "it has no variable model_reg"),
        (
            refusal(&|all| all.clear()),
            "not a DIIVINE model: it has no variable",
        ),
        (
            refusal(&|all| all[1].1 = row(&[1.0, 2.0])),
            "a_class is a 1 x 2 matrix, not a 1 x 88 matrix",
        ),
        (
            refusal(&|all| all[5].1 = Array::Text("svm")),
            "model_class is text, not one structure of libsvm",
        ),
        (
            refusal(&|all| all[6].1 = Array::Cell([1, 1], vec![row(&[1.0])])),
            "model_reg is a cell array of 1, not a cell array of 5",
        ),
        (
            field("model_class", "SVs", || None),
            "model_class.SVs is missing, not a 5 x 88 matrix",
        ),
        (
            field("model_class", "ProbA", || Some(row(&[]))),
            "model_class.ProbA is a 1 x 0 matrix, not 10 numbers",
        ),
        (
            field("model_class", "Label", || {
                Some(row(&[1.0, 2.0, 3.0, 4.0, 9.0]))
            }),
            "model_class.Label is a 1 x 5 matrix, not the numbers 1 to 5",
        ),
        (
            field("model_class", "totalSV", || Some(row(&[1e12]))),
            "model_class.totalSV",
        ),
        (
            field("model_class", "nSV", || {
                Some(row(&[9.0, 2.0, 3.0, 4.0, 9.0]))
            }),
            "classifier.support_vectors has 5 entries where 27 belong",
        ),
        (
            field("model_class", "rho", || Some(column(&[f64::NAN; 10]))),
            "classifier.rho[0] holds a number that is not finite",
        ),
        (
            field("model_reg", "Parameters", || {
                Some(column(&[4.0, 0.0, 3.0, 0.1, 0.0]))
            }),
            "model_reg{2} is of type 4 with kernel 0, not a support vector regression",
        ),
        (
            field("model_reg", "rho", || Some(column(&[f64::NAN]))),
            "regressors.jpeg.rho holds a number that is not finite",
        ),
    ] {
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
        assert!(!found.contains('\n'));
    }
}

#[test]
fn files_of_other_kinds_are_refused() {
    let mut big_endian = file(&[], false);
    big_endian[126..128].copy_from_slice(b"MI");
    let mut newer = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".to_vec();
    newer.resize(600, 0);
    for (bytes, expected) in [
        (b"".to_vec(), "its header is another"),
        (b"MATLAB 5.0 MAT-file".to_vec(), "its data break off"),
        (big_endian, "big-endian"),
        (newer, "of version 7.3 (HDF5); save it with -v7"),
        ([header(), tag(15, 400)].concat(), "its data break off"),
        (
            [header(), tag(15, 16), vec![7; 16]].concat(),
            "its compressed data are garbled",
        ),
    ] {
        let found = Model::from_matlab(&bytes, "x").unwrap_err().to_string();
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    }
}

/// Sizes that lie, bombs and deep nests: refused, and quickly.
#[test]
fn lies_and_bombs_are_refused() {
    let read = |bytes: &[u8]| {
        let found = matlab::variables(bytes, &["x"]).unwrap_err().to_string();
        assert!(found.len() < 200, "{found}");
        found
    };
    let head = |class: u8, dims: [i32; 2]| {
        let dims: Vec<u8> = dims.iter().flat_map(|d| d.to_le_bytes()).collect();
        let mut body = element(6, &[class, 0, 0, 0, 0, 0, 0, 0]);
        body.extend(element(5, &dims));
        body.extend(element(1, b"x"));
        body
    };
    let whole = |body: Vec<u8>| [header(), tag(14, body.len()), body].concat();
    // Cells, structures, full and sparse matrices of 2^30 by 2^30, and of -1 by 1.
    for class in [1, 2, 5, 6] {
        for dims in [[1 << 30, 1 << 30], [i32::MAX, 1], [-1, 1]] {
            let mut body = head(class, dims);
            body.extend(element(5, &32_i32.to_le_bytes()));
            body.extend(element(5, &[]));
            body.extend(element(9, &[]));
            read(&whole(body));
        }
    }
    // Many structures without any field.
    let mut body = head(2, [4000, 4000]);
    body.extend(element(5, &32_i32.to_le_bytes()));
    body.extend(element(1, &[]));
    assert!(read(&whole(body)).contains("more than"));
    // A nest of cells.
    let mut nest = matrix("", &row(&[1.0]));
    for _ in 0..20 {
        let mut body = head(1, [1, 1]);
        body.extend(&nest);
        nest = [tag(14, body.len()), body].concat();
    }
    assert!(read(&[header(), nest].concat()).contains("nested deeper than 8"));
    // 300 MiB of zeros in 300 kB.
    let deflated = miniz_oxide::deflate::compress_to_vec_zlib(&vec![0; 300 << 20], 1);
    let bomb = [header(), tag(15, deflated.len()), deflated].concat();
    assert!(bomb.len() < 4 << 20);
    assert!(read(&bomb).contains("inflates to more than 128 MiB"));
    // A sparse matrix with an entry outside.
    let mut body = head(5, [2, 1]);
    body.extend(element(5, &7_i32.to_le_bytes()));
    body.extend(element(5, &[0, 0, 0, 0, 1, 0, 0, 0]));
    body.extend(element(9, &1_f64.to_le_bytes()));
    assert!(read(&whole(body)).contains("an entry outside"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// A plain file has no checksums: changed numbers may make another model, but a model it is, or an error.
    #[test]
    fn damaged_plain_files_are_an_error_or_a_model(
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        cut in any::<prop::sample::Index>(),
        whole: bool,
    ) {
        let mut bytes = file(&variables(&small::model(1.0), true), false);
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if !whole {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(model) = Model::from_matlab(&bytes, "x") {
            prop_assert!(model.check().is_ok());
        }
    }

    /// A compressed file has: the same model or an error.
    #[test]
    fn damaged_compressed_files_are_an_error_or_the_same_model(at in any::<prop::sample::Index>(), value: u8, cut: bool) {
        let model = small::model(1.0);
        let mut bytes = file(&variables(&model, true), true);
        let at = at.index(bytes.len());
        if cut {
            bytes.truncate(at);
            prop_assert!(Model::from_matlab(&bytes, "x").is_err());
        } else {
            bytes[at] = value;
            if let Ok(read) = Model::from_matlab(&bytes, "x") {
                prop_assert!(same_numbers(&read, &model));
            }
        }
    }
}
