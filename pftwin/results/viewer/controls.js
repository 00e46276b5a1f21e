// Control bar of the viewer. Runs after k3d has loaded, in a page or below a notebook cell, with its instance
// `K3DInstance`. Uses plain HTML and only k3d's public functions.
(function (k3d, control) {
    const HEIGHT = 88; // [px]
    const target = k3d.getWorld().targetDOMNode;
    const ownPage = target.id === 'canvasTarget';
    const make = (tag, attributes, text) => {
        const element = document.createElement(tag);
        Object.entries(attributes || {}).forEach(([name, value]) => element.setAttribute(name, value));
        if (text !== undefined) { element.textContent = text; }
        return element;
    };
    const style = make('style', {}, `
        .pftwin { position: absolute; left: 0; right: 0; height: ${HEIGHT}px; padding: 6px 14px; box-sizing: border-box;
            z-index: 20; background: #fff; border-top: 1px solid #d5dbe1; color: #222; white-space: nowrap;
            font: 14px system-ui, 'Segoe UI', Helvetica, Arial, sans-serif; }
        .pftwin div { display: flex; align-items: center; gap: 10px; height: 38px; overflow-x: auto; }
        .pftwin button, .pftwin select { font: inherit; padding: 5px 10px; border: 1px solid #b8c2cc; cursor: pointer;
            border-radius: 5px; background: #f6f8fa; color: inherit; }
        .pftwin button:hover { background: #e8edf2; }
        .pftwin .play { min-width: 78px; background: #0072B2; border-color: #0072B2; color: #fff; }
        .pftwin .play:hover { background: #005f94; }
        .pftwin input[type=range] { flex: 1; min-width: 80px; accent-color: #0072B2; }
        .pftwin output { min-width: 62px; text-align: right; font-variant-numeric: tabular-nums; }
        .pftwin label { display: inline-flex; align-items: center; gap: 4px; }
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

    function look(name) { // moves the camera back if the page is too narrow for the scene
        const camera = control.views[name].slice(), aside = [0, 1, 2].map((i) => camera[i] - camera[i + 3]);
        const seen = 2 * Math.hypot(...aside) * Math.tan(control.angle * Math.PI / 360);
        const shape = target.clientWidth > 0 ? target.clientHeight / target.clientWidth : 0; // not laid out yet: 0
        const factor = Math.max(1, control.width * shape / seen);
        aside.forEach((a, i) => { camera[i] = camera[i + 3] + factor * a; });
        k3d.setCamera(camera);
    }
    Object.keys(control.views).forEach((name) => {
        const button = make('button', { type: 'button' }, name[0].toUpperCase() + name.slice(1));
        button.addEventListener('click', () => look(name));
        lower.append(button);
    });
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
        });
    }
    const clearBox = make('input', { type: 'checkbox' }), solid = {};
    function seeThrough(clear) {
        clearBox.checked = clear;
        const objects = k3d.getWorld().ObjectsListJson;
        return Promise.all(control.patellae.map((id) => {
            solid[id] = solid[id] ?? objects[id].opacity;
            objects[id].opacity = clear ? 0.3 * solid[id] : solid[id];
            return k3d.reload(objects[id], { opacity: objects[id].opacity });
        })).then(() => show(parseFloat(slider.value)));
    }
    if (control.patellae.length > 0) {
        const label = make('label');
        label.append(clearBox, make('span', {}, 'see-through patella'));
        clearBox.addEventListener('change', () => seeThrough(clearBox.checked));
        lower.append(label);
    }
    const panel = make('button', { type: 'button', title: 'all settings of the drawing' }, '\u2699');
    let open = false;
    panel.addEventListener('click', () => { open = !open; k3d.setMenuVisibility(open); });
    lower.append(make('span', { style: 'flex:1' }), panel);
    if (getComputedStyle(target).position === 'static') { target.style.position = 'relative'; }
    if (ownPage) { target.style.height = `calc(100% - ${HEIGHT}px)`; }
    bar.style.bottom = ownPage ? `-${HEIGHT}px` : '0';
    bar.prepend(style);
    target.appendChild(bar);
    k3d.setMenuVisibility(false);
    k3d.resizeHelper();
    look('anterior');
    show(control.begin);
    bar.viewer = { k3d, control, show, look, seeThrough, drawn: () => !busy };
}(K3DInstance, /*CONTROL*/null));
