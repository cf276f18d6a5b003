//! The known word nearest to a mistyped one.

/// Number of insertions, deletions, changes and swaps of neighbours between two words (optimal string alignment).
fn edit_distance(a: &str, b: &str) -> usize {
    let a: Vec<char> = a.chars().collect();
    let b: Vec<char> = b.chars().collect();
    let mut table = vec![vec![0; b.len() + 1]; a.len() + 1];
    for (i, row) in table.iter_mut().enumerate() {
        row[0] = i;
    }
    for (j, cell) in table[0].iter_mut().enumerate() {
        *cell = j;
    }
    for i in 1..=a.len() {
        for j in 1..=b.len() {
            let change = table[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = change.min(table[i - 1][j] + 1).min(table[i][j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(table[i - 2][j - 2] + 1);
            }
            table[i][j] = best;
        }
    }
    table[a.len()][b.len()]
}

/// The nearest of the known words; ties go to the earlier one. `None` without any words.
pub(crate) fn nearest<'a>(
    typed: &str,
    known: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    // Nobody mistypes a word of a thousand letters; a bound keeps the table small.
    let typed: String = typed.chars().take(80).collect::<String>().to_lowercase();
    known
        .into_iter()
        .min_by_key(|word| edit_distance(&typed, word))
}

#[cfg(test)]
mod tests {
    //! The distance is that of hand-counted examples.
    use super::*;

    #[test]
    fn distances_counted_by_hand() {
        for (a, b, d) in [
            ("", "", 0),
            ("base", "", 4),
            ("base", "case", 1),
            ("interaxail", "interaxial", 1),
            ("kitten", "sitting", 3),
        ] {
            assert_eq!(edit_distance(a, b), d, "{a} {b}");
            assert_eq!(edit_distance(b, a), d, "{b} {a}");
        }
        assert_eq!(
            nearest("focal_lenght", ["far", "focal_length", "fps"]),
            Some("focal_length")
        );
    }
}
