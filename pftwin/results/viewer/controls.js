// Control bar of the viewer. Runs after k3d has loaded, in a page or below a notebook cell, with its instance
// `K3DInstance`. Uses plain HTML and only k3d's public functions.
(function (k3d, control) {
    const BESIDE = 68; // on either side of the scene, for the words "lateral" and "medial" [px]
    const NEAR = 8; // least distance of the scene from legend and numbers [px]
    const target = k3d.getWorld().targetDOMNode;
    const ownPage = target.id === 'canvasTarget';
    const make = (tag, attributes, text) => {
        const element = document.createElement(tag);
        Object.entries(attributes || {}).forEach(([name, value]) => element.setAttribute(name, value));
        if (text !== undefined) { element.textContent = text; }
        return element;
    };
    const style = make('style', {}, `
        .pftwin { position: absolute; left: 0; right: 0; padding: 6px 14px; box-sizing: border-box;
            z-index: 20; background: #fff; border-top: 1px solid #d5dbe1; color: #222; white-space: nowrap;
            font: 14px system-ui, 'Segoe UI', Helvetica, Arial, sans-serif; }
        .pftwin div { display: flex; align-items: center; gap: 4px 10px; min-height: 38px; flex-wrap: wrap; }
        .pftwin button, .pftwin select { font: inherit; padding: 5px 10px; border: 1px solid #b8c2cc; cursor: pointer;
            border-radius: 5px; background: #f6f8fa; color: inherit; }
        .pftwin button:hover { background: #e8edf2; }
        .pftwin .play { min-width: 78px; background: #0072B2; border-color: #0072B2; color: #fff; }
        .pftwin .play:hover { background: #005f94; }
        .pftwin input[type=range] { flex: 1; min-width: 80px; accent-color: #0072B2; }
        .pftwin output { min-width: 62px; text-align: right; font-variant-numeric: tabular-nums; }
        .pftwin label { display: inline-flex; align-items: center; gap: 4px; }
        .pftwin input[type=checkbox] { margin: 3px 2px; }
        .pftwin-legend { max-width: 290px; }
        @media (max-width: 800px) { .pftwin-legend { max-width: calc(98vw - 14px); } }
        @media (max-width: 480px) {
            .pftwin { padding: 6px 8px; }
            .pftwin div { gap: 4px 6px; }
            .pftwin button, .pftwin select { padding: 5px 7px; }
            .pftwin output { min-width: 50px; }
            .pftwin input[type=range] { min-width: 50px; }
        }
        @media print { /* the knee as it stands */
            .pftwin { display: none; }
            #canvasTarget { height: 100% !important; print-color-adjust: exact; }
            #canvasTarget canvas { width: 100% !important; height: 100% !important; object-fit: contain; }
        }`);
    const bar = make('div', { class: 'pftwin' }), upper = make('div'), lower = make('div');
    bar.append(upper, lower);
    const play = make('button', { class: 'play', type: 'button' }, '\u25B6 Play');
    const slider = make('input', { type: 'range', min: control.begin, max: control.end, step: 'any',
        'aria-label': 'time' });
    const clock = make('output');
    const speed = make('select', { 'aria-label': 'speed' });
    [0.1, 0.25, 0.5, 1, 2].forEach((s) => speed.appendChild(make('option', { value: s }, `${s} \u00D7`)));
    speed.value = 1;

    let busy = false, wanted = null, playing = false, before = null;
    function draw(time) { // one frame at a time: a slow machine skips frames instead of falling behind
        wanted = time;
        if (busy) { return; }
        busy = true;
        const now = wanted;
        wanted = null;
        Promise.resolve(k3d.setTime(now)).finally(() => {
            busy = false;
            if (wanted !== null) { draw(wanted); }
        });
    }
    function tell(time) {
        slider.value = time;
        clock.textContent = `${time.toFixed(2)} s`;
    }
    function show(time) {
        time = Math.min(Math.max(time, control.begin), control.end);
        tell(time);
        draw(time);
    }
    k3d.on(k3d.events.TIME_CHANGE, (time) => { if (!busy) { tell(time); } }); // by k3d's panel, or from Python
    function tick(now) {
        if (!playing || !bar.isConnected) { return; }
        let time = parseFloat(slider.value) + (before === null ? 0 : speed.value * (now - before) / 1000);
        before = now;
        if (time > control.end) { time = control.begin; }
        show(time);
        requestAnimationFrame(tick);
    }
    function toggle() {
        playing = !playing;
        before = null;
        play.textContent = playing ? '\u275A\u275A Pause' : '\u25B6 Play';
        if (playing) { requestAnimationFrame(tick); }
    }
    play.addEventListener('click', toggle);
    slider.addEventListener('input', () => show(parseFloat(slider.value)));
    if (ownPage) { // in a notebook, the keyboard belongs to the notebook
        document.addEventListener('keydown', (event) => {
            if (event.code === 'Space' && event.target === document.body) { event.preventDefault(); toggle(); }
        });
    }
    upper.append(play, slider, clock, speed);

    function freeAreas() { // rectangles [px] that legend (top left) and numbers (bottom right) leave free
        const width = target.clientWidth, height = target.clientHeight - (ownPage ? 0 : bar.offsetHeight);
        const [legend, numbers] = ['legend', 'numbers'].map((name) => {
            const box = target.querySelector(`.pftwin-${name}`);
            return box === null ? [0, 0] : [box.parentElement.offsetWidth + 0.01 * width + NEAR,
                box.parentElement.offsetHeight + 0.015 * target.clientHeight + NEAR];
        });
        return [[0, legend[1]], [legend[0], 0]].flatMap(([left, top]) => [[0, numbers[1]], [numbers[0], 0]].map(
            ([right, bottom]) => ({ left, top, right: width - right, bottom: height - bottom })));
    }
    let current = 'anterior'; // the view that follows changes of the page's size; null once the user has turned it
    function look(name) { // fits the extent of the joint and of the patella's path into the largest free area
        current = name;
        const width = target.clientWidth, height = target.clientHeight;
        if (width === 0 || height === 0) { return; } // not laid out yet; k3d tells when it is
        const camera = control.views[name], middle = camera.slice(3, 6), up = camera.slice(6);
        const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
        const unit = (a) => a.map((x) => x / Math.hypot(...a));
        const back = unit(middle.map((m, i) => camera[i] - m));
        const right = unit(cross(up, back)), above = cross(back, right);
        const [across, high] = [right, above].map((axis) => {
            const places = control.extent.map((corner) => dot(axis, corner.map((x, i) => x - middle[i])));
            const least = Math.min(...places), most = Math.max(...places);
            return { size: most - least, middle: (least + most) / 2 };
        });
        // Scales in px per mm, and offsets of the scene's middle from the page's in px: as small as the area allows.
        const offset = (least, most, size, whole) => Math.min(Math.max(whole, 2 * least + size), 2 * most - size) / 2
            - whole / 2;
        const [best] = freeAreas().map((area) => {
            const scale = Math.min((area.right - area.left - 2 * BESIDE) / across.size,
                (area.bottom - area.top) / high.size, height / control.height);
            const x = offset(area.left, area.right, scale * across.size + 2 * BESIDE, width);
            const y = offset(area.top, area.bottom, scale * high.size, height);
            return { scale, x, y };
        }).sort((one, two) => two.scale - one.scale || Math.hypot(one.x, one.y) - Math.hypot(two.x, two.y));
        const least = height / (4 * control.height); // a page that is all legend shows the knee behind it
        const { scale, x, y } = best.scale > least ? best : { scale: least, x: 0, y: 0 };
        const aside = across.middle - x / scale, over = high.middle + y / scale;
        const seen = middle.map((m, i) => m + aside * right[i] + over * above[i]);
        const distance = height / (2 * scale * Math.tan(control.angle * Math.PI / 360));
        k3d.setCamera([...seen.map((m, i) => m + distance * back[i]), ...seen, ...up]);
    }
    ['pointerdown', 'wheel'].forEach((kind) => target.addEventListener(kind, (event) => {
        if (!bar.contains(event.target)) { current = null; }
    }, { capture: true, passive: true }));
    k3d.on(k3d.events.RESIZED, () => { if (current !== null && bar.isConnected) { look(current); } });
    Object.keys(control.views).forEach((name) => {
        const button = make('button', { type: 'button' }, name[0].toUpperCase() + name.slice(1));
        button.addEventListener('click', () => look(name));
        lower.append(button);
    });
    const hidden = []; // boxes to uncheck once all is drawn
    if (control.results.length > 1) {
        const objects = k3d.getWorld().ObjectsListJson;
        const before = {};
        control.results.forEach((result) => {
            const box = make('input', { type: 'checkbox', checked: '' });
            const label = make('label', {}, '');
            label.append(box, make('span', { style: `color:${result.colour};font-weight:600` }, result.name));
            box.addEventListener('change', () => {
                result.ids.forEach((id) => { // k3d removes invisible objects from the scene
                    if (!box.checked) { before[id] = objects[id].visible; }
                    objects[id].visible = box.checked ? before[id] : false;
                    k3d.reload(objects[id], { visible: objects[id].visible });
                });
                show(parseFloat(slider.value));
            });
            lower.append(label);
            if (result.hidden) { hidden.push(box); }
        });
    }
    const clearBox = make('input', { type: 'checkbox' }), solid = {};
    function seeThrough(clear) {
        clearBox.checked = clear;
        const objects = k3d.getWorld().ObjectsListJson;
        return Promise.all(control.patellae.map((id) => {
            solid[id] = solid[id] ?? objects[id].opacity;
            objects[id].opacity = clear ? 0.15 * solid[id] : solid[id];
            return k3d.reload(objects[id], { opacity: objects[id].opacity });
        })).then(() => show(parseFloat(slider.value)));
    }
    if (control.patellae.length > 0) {
        const label = make('label');
        label.append(clearBox, make('span', {}, 'see-through patella'));
        clearBox.addEventListener('change', () => seeThrough(clearBox.checked));
        lower.append(label);
    }
    const panel = make('button', { type: 'button', title: 'all settings of the drawing',
        style: 'margin-left: auto' }, '\u2699');
    let open = false;
    panel.addEventListener('click', () => { open = !open; k3d.setMenuVisibility(open); });
    lower.append(panel);
    if (getComputedStyle(target).position === 'static') { target.style.position = 'relative'; }
    bar.prepend(style);
    target.appendChild(bar);
    function layOut() { // the bar below the drawing; on a narrow page it has more rows
        bar.style.bottom = ownPage ? `-${bar.offsetHeight}px` : '0';
        if (ownPage) { target.style.height = `calc(100% - ${bar.offsetHeight}px)`; }
    }
    layOut();
    new ResizeObserver(layOut).observe(bar);
    k3d.setMenuVisibility(false);
    k3d.resizeHelper();
    look('anterior');
    show(control.opening);
    if (control.see_through) { seeThrough(true); }
    hidden.forEach((box) => box.click());
    bar.viewer = { k3d, control, show, look, seeThrough, drawn: () => !busy };
}(K3DInstance, /*CONTROL*/null));
