//! Prints the whole content of an archive as JSON, like the second reader does: `spec/reader.py --twin` compares the
//! two.

#[path = "../tests/common/content.rs"]
mod content;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args_os().nth(1).ok_or("which archive?")?;
    println!("{}", content::content_or_rule(std::fs::read(path)?));
    Ok(())
}
