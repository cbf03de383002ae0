//! Devices that are absent, small, lost or out of memory; scenes and questions at the limits.

mod common;

use common::{Asker, device, device_with, generated, generated_archive, partly_loaded, random_pages};
use slicewalk::frame::{Frame, PageKey};
use slicewalk::nalgebra::Vector3;
use slicewalk::page::{PageBuilder, Span};
use slicewalk::query::{Aabb, Cylinder, Ray, Sphere, cast, floor_under, overlaps};
use slicewalk::store::{MotionHint, Snapshot, Stream, StreamOptions};
use slicewalk_gpu::{Below, Device, Error, Options, Question, Reply, Scene};
use std::future::Future;
use std::pin::pin;
use std::process::Command;
use std::task::{Context, Poll, Waker};

fn answers<Q: Question>(scene: &Scene, questions: &[Q]) -> Vec<Reply<Q::Answer>> {
    scene.ask(questions).unwrap().wait().unwrap().answers
}

fn check_boxes(scene: &Scene, boxes: &[Aabb]) {
    let expected: Vec<Reply<bool>> = boxes.iter().map(|shape| overlaps(scene.pages(), shape).into()).collect();
    assert!(answers(scene, boxes) == expected);
}

/// Unless there is a graphics card, the software adapter is not taken for one.
#[test]
fn without_a_card_the_processor_answers_and_the_reason_is_given_once() {
    let pages = random_pages(4, 0.0).pages;
    let (scene, reason) = Scene::open(&pages, &Options::default());
    assert_eq!(scene.device().is_none(), reason.is_some());
    if let Some(reason) = reason {
        assert!(matches!(reason, Error::NoAdapter { .. }), "{reason}");
        assert!(reason.to_string().starts_with("no graphics card: "), "{reason}");
        assert_eq!(scene.device_bytes(), 0);
    }
    let mut asker = Asker::new(&pages, 1);
    let boxes: Vec<_> = (0..1000).map(|_| asker.shape()).collect();
    check_boxes(&scene, &boxes);
    let scene = Scene::on_processor(&pages);
    check_boxes(&scene, &boxes);
    assert!(scene.ask(&boxes).unwrap().is_ready());
    assert_eq!(scene.ask(&boxes).unwrap().wait().unwrap().by_processor, boxes.len());
    let rays: Vec<_> = (0..1000).map(|_| asker.ray()).collect();
    let expected: Vec<_> = rays.iter().map(|ray| Reply::from(cast(&pages, ray))).collect();
    assert!(answers(&scene, &rays) == expected);
}

/// Opens the device of a system without drivers; run by the next test in a process of its own.
#[test]
#[ignore = "needs an environment without drivers"]
fn in_a_process_without_drivers() {
    let error = Device::open(&Options { software: true, buffer_bytes: None }).unwrap_err();
    assert!(matches!(error, Error::NoAdapter { .. }), "{error}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_system_without_drivers_has_no_adapter() {
    let nothing = "/does/not/exist.json";
    let out = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "in_a_process_without_drivers", "--ignored"])
        .envs([("VK_DRIVER_FILES", nothing), ("VK_ICD_FILENAMES", nothing)])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.success() && said.contains("1 passed"), "{said}");
}

#[test]
fn pages_beyond_a_limit_are_refused_and_small_pieces_answer_alike() {
    let Some(device) = device_with(Some(64 << 10)) else { return };
    let house = generated("house", 100_000, 0.05).pages;
    let error = Scene::new(&device, &house).unwrap_err();
    let Error::TooLarge { what: "pages", found, limit: 65_536 } = error else { panic!("{error}") };
    assert!(found > 65_536);
    assert!(
        error.to_string().starts_with("pages: too large for the device (expected at most 65536, found "),
        "{error}"
    );

    // A scene that fits is answered in pieces of at most 64 KiB.
    let pages = random_pages(0, 0.0).pages;
    let scene = Scene::new(&device, &pages).unwrap();
    let mut asker = Asker::new(&pages, 2);
    let boxes: Vec<_> = (0..10_000).map(|_| asker.shape()).collect();
    check_boxes(&scene, &boxes);
    let rays: Vec<_> = (0..3000).map(|_| asker.ray()).collect();
    let expected: Vec<_> = rays.iter().map(|ray| Reply::from(cast(&pages, ray))).collect();
    assert!(answers(&scene, &rays) == expected);
}

#[test]
fn scenes_wider_than_the_devices_integers_are_refused() {
    let Some(device) = device() else { return };
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(0, 0, &[Span::new(0, 10, false).unwrap()]));
    let page = builder.build();
    let frame = Frame::new(0.05, 0.15).unwrap();
    let scene = |far: PageKey| {
        let keys = [PageKey { tx: 0, ty: 0, layer: 0 }, far];
        Scene::new(&device, &Snapshot::from_pages(frame, keys.map(|key| (key, page.clone()))))
    };
    for (far, expected) in [
        (PageKey { tx: i32::MIN, ty: 0, layer: 0 }, "pixels along x"),
        (PageKey { tx: 0, ty: i32::MAX, layer: 0 }, "pixels along y"),
        (PageKey { tx: 0, ty: 0, layer: 1 << 20 }, "quanta of height"),
    ] {
        let error = scene(far).unwrap_err();
        assert!(matches!(error, Error::TooLarge { what, .. } if what == expected), "{error}");
    }
    // The greatest distances that fit.
    for far in [
        PageKey { tx: -(1 << 24) + 1, ty: 0, layer: 0 },
        PageKey { tx: 0, ty: (1 << 24) - 1, layer: 0 },
        PageKey { tx: 0, ty: 0, layer: (1 << 30) / 16320 - 1 },
    ] {
        let scene = scene(far).unwrap();
        let mut asker = Asker::new(scene.pages(), 3);
        let boxes: Vec<_> = (0..1000).map(|_| asker.shape()).collect();
        check_boxes(&scene, &boxes);
        let spheres: Vec<_> = (0..1000).map(|_| asker.sphere()).collect();
        let expected: Vec<Reply<bool>> = spheres.iter().map(|shape| overlaps(scene.pages(), shape).into()).collect();
        assert!(answers(&scene, &spheres) == expected);
    }
}

#[test]
fn a_lost_device_fails_every_batch_and_another_one_answers() {
    let Some(gone) = device() else { return };
    let pages = random_pages(1, 0.0).pages;
    let scene = Scene::new(&gone, &pages).unwrap();
    let mut asker = Asker::new(&pages, 3);
    let boxes: Vec<_> = (0..1000).map(|_| asker.shape()).collect();
    check_boxes(&scene, &boxes);
    let pending = scene.ask(&boxes).unwrap();
    gone.wgpu().0.destroy();
    // A batch that was sent before has all of its answers, or fails.
    match pending.wait() {
        Ok(replies) => assert_eq!(replies.answers.len(), boxes.len()),
        Err(error) => assert!(matches!(error, Error::Lost { .. }), "{error}"),
    }
    for _ in 0..2 {
        let error = scene.ask(&boxes).and_then(|pending| pending.wait()).unwrap_err();
        assert!(matches!(error, Error::Lost { .. }), "{error}");
        assert!(error.to_string().starts_with("device lost: "), "{error}");
    }
    assert!(matches!(Scene::new(&gone, &pages), Err(Error::Lost { .. })));
    check_boxes(&Scene::new(&device().unwrap(), &pages).unwrap(), &boxes);
}

#[test]
fn scenes_and_batches_may_be_empty() {
    let Some(device) = device() else { return };
    let frame = Frame::new(0.05, 0.15).unwrap();
    let scene = Scene::new(&device, &Snapshot::from_pages(frame, [])).unwrap();
    let everything = Aabb::new([f64::NEG_INFINITY; 3].into(), [f64::INFINITY; 3].into()).unwrap();
    assert_eq!(answers(&scene, &[everything]), [Reply::Known(false)]);
    let below = Below { shape: everything, from: f64::INFINITY, depth: f64::INFINITY };
    assert_eq!(answers(&scene, &[below]), [Reply::Known(None)]);
    let ray = Ray::new([0.0; 3].into(), [1.0, 2.0, 3.0].into(), f64::INFINITY).unwrap();
    assert_eq!(answers(&scene, &[ray]), [Reply::Known(None)]);
    assert_eq!(answers::<Aabb>(&scene, &[]), []);

    // All pages are known, none is in memory.
    let pages = random_pages(2, 0.0).pages;
    let scene = Scene::new(&device, &pages.keep_loaded(|_| false)).unwrap();
    assert_eq!(answers(&scene, &[everything]), [Reply::NotLoaded]);
    assert_eq!(answers(&scene, &[below]), [Reply::NotLoaded]);
}

/// Each window is a scene of its own.
#[test]
fn windows_of_a_stream_answer_as_far_as_they_reach() {
    let Some(device) = device() else { return };
    let archive = generated_archive("house", 100_000, 0.05);
    let everything = Snapshot::resident(&archive, &slicewalk::NoMonitor).unwrap();
    let stream = Stream::open(archive, StreamOptions::new(2 << 20)).unwrap();
    let mut asker = Asker::new(&everything, 9);
    let boxes: Vec<_> = (0..3000).map(|_| asker.shape()).collect();
    let mut counts = [0, 0];
    for _ in 0..4 {
        let at = asker.place();
        let near = |side: f64| at + Vector3::repeat(side);
        stream.load_around(&MotionHint::walking(near(-0.5), near(0.5), Vector3::zeros())).unwrap();
        let scene = Scene::new(&device, &stream.snapshot()).unwrap();
        check_boxes(&scene, &boxes);
        for (shape, reply) in boxes.iter().zip(answers(&scene, &boxes)) {
            counts[usize::from(reply == Reply::NotLoaded)] += 1;
            // Known answers stay known.
            assert!(reply == Reply::NotLoaded || reply == overlaps(&everything, shape).into());
        }
    }
    assert!(counts.iter().all(|&count| count > 100), "{counts:?} known and not loaded");
}

/// The device would take long for these, or cannot decide them: the processor answers.
#[test]
fn questions_of_any_size_are_answered() {
    let Some(device) = device() else { return };
    let mut builder = PageBuilder::default();
    assert!(builder.set_column(9, 9, &[Span::new(100, 400, true).unwrap()]));
    let page = builder.build();
    let keys = [0, 3000].map(|tx| PageKey { tx, ty: 0, layer: 0 });
    let pages = Snapshot::from_pages(Frame::new(0.05, 0.15).unwrap(), keys.map(|key| (key, page.clone())));
    let scene = Scene::new(&device, &pages).unwrap();
    let boxes = [Aabb::new([0.0; 3].into(), [9000.0, 3.0, 0.05].into()).unwrap()];
    let rays = [Ray::new([1.0, 0.475, 0.1].into(), [1.0, 0.0, 0.0].into(), f64::INFINITY).unwrap()];
    let spheres =
        [Sphere::new([4000.0, 1.0, 0.0].into(), 1e99).unwrap(), Sphere::new([0.475, 0.475, 0.1].into(), 0.0).unwrap()];
    let cylinders = [Cylinder::new([4000.0, 1.0, 0.0].into(), 5000.0, 1.0).unwrap()];
    let replies = scene.ask(&boxes).unwrap().wait().unwrap();
    assert_eq!((replies.answers, replies.by_processor), (vec![overlaps(&pages, &boxes[0]).into()], 1));
    let replies = scene.ask(&rays).unwrap().wait().unwrap();
    assert_eq!((replies.answers, replies.by_processor), (vec![cast(&pages, &rays[0]).into()], 1));
    let replies = scene.ask(&spheres).unwrap().wait().unwrap();
    assert_eq!((replies.answers, replies.by_processor), (vec![Reply::Known(true); 2], 2));
    let replies = scene.ask(&cylinders).unwrap().wait().unwrap();
    assert_eq!((replies.answers, replies.by_processor), (vec![overlaps(&pages, &cylinders[0]).into()], 1));
}

/// llvmpipe ends loops without an error after 65,535 steps. Floors under half a house take more.
#[test]
fn questions_that_take_many_steps_are_answered() {
    let Some(device) = device() else { return };
    let house = generated("house", 400_000, 0.05);
    let pages = partly_loaded(&house, 7).pages;
    let scene = Scene::new(&device, &pages).unwrap();
    let everything = [f64::NEG_INFINITY, f64::INFINITY];
    let shape = Aabb::new([everything[0], -0.25, 7.0].into(), [3.3, everything[1], 7.5].into()).unwrap();
    let quantum = pages.frame().quantum_m();
    // Where the floor lies just below the begin of the search, the missing pages decide.
    let questions: Vec<_> = (9850..9870)
        .map(|top| Below { shape, from: (f64::from(top) + 0.5) * quantum, depth: 100.0 * quantum })
        .collect();
    let expected: Vec<_> =
        questions.iter().map(|below| Reply::from(floor_under(&pages, &shape, below.from, below.depth))).collect();
    assert!(expected.contains(&Reply::NotLoaded));
    assert_eq!(answers(&scene, &questions), expected);
}

#[test]
fn several_batches_may_be_in_flight() {
    let Some(device) = device() else { return };
    let pages = random_pages(3, 5e5).pages;
    let scene = Scene::new(&device, &pages).unwrap();
    let mut asker = Asker::new(&pages, 5);
    let boxes: Vec<_> = (0..3000).map(|_| asker.shape()).collect();
    let rays: Vec<_> = (0..3000).map(|_| asker.ray()).collect();
    let (first, second, third) = (scene.ask(&boxes).unwrap(), scene.ask(&rays).unwrap(), scene.ask(&boxes).unwrap());
    let third = third.wait().unwrap();
    while !second.is_ready() {
        std::thread::yield_now();
    }
    let expected: Vec<_> = rays.iter().map(|ray| Reply::from(cast(&pages, ray))).collect();
    assert!(second.wait().unwrap().answers == expected);
    // The first one without blocking.
    let mut future = pin!(first.collect());
    let first = loop {
        if let Poll::Ready(first) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            break first.unwrap();
        }
    };
    assert!(first == third);
    let expected: Vec<Reply<bool>> = boxes.iter().map(|shape| overlaps(&pages, shape).into()).collect();
    assert!(first.answers == expected);
}

/// A finished batch is reported to whichever thread polls next, so the thread that waits for it may hear of it late.
#[test]
fn threads_share_a_device() {
    let Some(device) = device() else { return };
    let pages = random_pages(3, 5e5).pages;
    let scene = Scene::new(&device, &pages).unwrap();
    let mut asker = Asker::new(&pages, 6);
    let boxes: Vec<_> = (0..10).map(|_| asker.shape()).collect();
    let expected: Vec<Reply<bool>> = boxes.iter().map(|shape| overlaps(&pages, shape).into()).collect();
    std::thread::scope(|threads| {
        for _ in 0..8 {
            threads.spawn(|| (0..100).for_each(|_| assert!(answers(&scene, &boxes) == expected)));
        }
    });
}
