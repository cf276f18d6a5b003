//! Proves: the reference page names every channel, and every field of our own messages with its number, type and meaning.

use vergence_record::Topic;
use vergence_record::table::Kind;

#[test]
fn the_page_is_complete() {
    let page = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../docs/reference-recording.md"
    );
    let page = std::fs::read_to_string(page).unwrap();
    let mut fields = 0;
    for topic in Topic::ALL {
        assert!(page.contains(&format!("`{}`", topic.name())), "{topic:?}");
        assert!(page.contains(&format!("`{}`", topic.schema())), "{topic:?}");
        let Some((name, columns)) = topic.row() else {
            continue;
        };
        for (index, column) in columns.iter().enumerate() {
            let kind = match column.kind {
                Kind::Number => "double",
                Kind::Count => "uint64",
                Kind::Flag => "bool",
                Kind::Text => "string",
            };
            let optional = if column.optional { "optional " } else { "" };
            let line = format!(
                "| {} | `{}` | {optional}{kind} | {} |",
                index + 1,
                column.name,
                column.meaning
            );
            assert!(page.contains(&line), "{name} lacks: {line}");
            fields += 1;
        }
    }
    assert!(fields > 150);
}
