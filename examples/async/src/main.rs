//! Walks in an archive on a web server or in an object store without a thread of the library: fetches are tasks, and
//! the loader decides which. `cargo run -p stream-async -- https://host/scan.slices X,Y,Z`

use nalgebra::{Point3, Vector2};
use object_store::{GetOptions, GetRange, ObjectStore};
use slicewalk::store::{Loader, LoaderOptions, Next};
use slicewalk::walk::{Config, MoveInput, Walker};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::task::JoinSet;

const FRAME: Duration = Duration::from_micros(16_667);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(walk())
}

async fn walk() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [url, start] = &arguments[..] else { return Err("usage: stream-async URL X,Y,Z".into()) };
    let start = start.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    let [x, y, z] = start[..] else { return Err("the start is X,Y,Z".into()) };
    // The program chooses the cryptography for TLS; its own features of `object_store` may provide one instead.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let (store, path) = object_store::parse_url(&url::Url::parse(url)?)?;
    let store: Arc<dyn ObjectStore> = store.into();

    let mut loader = Loader::open(None, LoaderOptions::new(64 << 20));
    let (body, mut fetches, origin) = (loader.body(), JoinSet::new(), Instant::now());
    let mut pawn = Walker::new(Config::default(), Point3::new(x, y, z))?;
    let (mut frames, mut next_frame) = (0, Duration::ZERO);
    while frames < 600 {
        // Everything that is due now.
        let again = loop {
            match loader.poll(origin.elapsed())? {
                Next::Fetch(fetch) => {
                    let (store, path) = (store.clone(), path.clone());
                    fetches.spawn(async move {
                        let range = Some(GetRange::Bounded(fetch.range));
                        let answer = store.get_opts(&path, GetOptions { range, ..GetOptions::default() }).await;
                        let bytes = match answer {
                            Ok(answer) => answer.bytes().await,
                            Err(error) => Err(error),
                        };
                        (fetch.id, bytes)
                    });
                }
                Next::Report(page) => eprintln!("{}: {}", page.key, page.error),
                // The answer will be ignored.
                Next::Cancel(_) => {}
                Next::Wait(again) => break again.unwrap_or(Duration::MAX).min(next_frame),
            }
        };
        // Wait for an answer or the next frame.
        let pause = again.saturating_sub(origin.elapsed());
        let answer = match fetches.is_empty() {
            true => {
                tokio::time::sleep(pause).await;
                None
            }
            false => tokio::time::timeout(pause, fetches.join_next()).await.ok().flatten(),
        };
        match answer.transpose()? {
            Some((id, Ok(bytes))) => {
                if let Some(job) = loader.given(id, bytes.into(), origin.elapsed()) {
                    let decoded = tokio::task::spawn_blocking(|| job.run()).await?;
                    loader.loaded(decoded, origin.elapsed());
                }
            }
            Some((id, Err(error))) => {
                let error = slicewalk::Error::io(url, "read", std::io::Error::other(error));
                loader.failed(id, error, origin.elapsed());
            }
            None => {}
        }
        if origin.elapsed() < next_frame {
            continue;
        }
        next_frame = origin.elapsed() + FRAME;
        if let Some(view) = loader.snapshot() {
            pawn.step(&view, FRAME.as_secs_f64(), MoveInput::Direction(Vector2::y()));
            loader.hint(body, &pawn.motion_hint(slicewalk::store::Snapshot::frame(&view)));
            frames += 1;
            if frames % 60 == 0 {
                let at = pawn.feet();
                println!("{:.2}, {:.2}, {:.2} {:?}", at.x, at.y, at.z, pawn.state());
            }
        }
    }
    Ok(())
}
