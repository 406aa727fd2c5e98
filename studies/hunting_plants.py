"""TEMPORARY foreseen from simulated steps."""
import numpy as np, xarray as xr, fastcoil as fc
REST,RESP,SEEN,LEV,DU=2400,2000,10,np.linspace(.03,.9,14),.03
SERIES = ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")
def foreseen(loop, day):
    c={k:day.series[k].mean(1) for k in SERIES}; n=day.n_days; L=len(LEV)
    cc={k:np.repeat(np.repeat(x,L)[:,None],REST+RESP,1) for k,x in c.items()}
    cmd=np.tile(LEV,n)[:,None]+DU*(np.arange(REST+RESP)>=REST)[None]
    ds=fc.simulate(loop.assign(noise_std=0.),fc.Boundary(**cc,day=list(range(n*L))),command=cmd,traces=['T_measured'],trace_interval=SEEN,warm_up=0)
    dims=list(loop.sizes)
    T=ds.T_measured.transpose(*dims,"day","elapsed_time").values
    shape=T.shape[:-2]; T=T.reshape(-1,n,L,T.shape[-1])[...,REST//SEEN:]
    heat=loop['action']=='heating' if isinstance(loop['action'],str) else str(np.ravel(xr.DataArray(loop['action']).values)[0])=='heating'
    T0=T[...,0]; i=np.abs(T0-c['T_set'][None,:,None]).argmin(-1)
    reach=(T0.min(-1)<c['T_set'])&(T0.max(-1)>c['T_set'])
    y=np.take_along_axis(T,i[...,None,None],2)[:,:,0]; y=(y-y[...,:1])*(1 if heat else -1)
    end=y[...,-1]; t=lambda s:SEEN*(y>=s*end[...,None]).argmax(-1)
    t1,t2=t(.353),t(.853); tau=np.maximum(.67*(t2-t1),1); th=np.maximum(1.3*t1-.29*t2,0)
    K=end/DU
    def col(name):
        a=xr.DataArray(loop[name]); a=a.broadcast_like(xr.DataArray(np.zeros(shape),dims=dims)).transpose(*dims) if a.dims!=tuple(dims) else a
        return np.repeat(np.asarray(a.values,float).reshape(-1)[:,None],n,1)
    ts=col('sample_time'); m,g,p=margins(y.reshape(-1,y.shape[-1])/DU,SEEN,col('kp').ravel(),col('ti').ravel(),ts.ravel())
    full=(*shape,n)
    D=lambda a:((*dims,'day'),a.reshape(full))
    return xr.Dataset(dict(K=D(K),T=D(tau),theta=D(np.maximum(th+.5*ts,1)),margin=D(m),gain_margin=D(g),phase_margin=D(p),reachable=D(reach&(K>.2))),coords=dict(day=day.day))
def Nsize(left):
    k=np.linspace(1e-6,1-1e-6,2000)
    real=(.5*np.pi+np.arcsin(1-2*k)+2*(1-2*k)*np.sqrt(k*(1-k)))/np.pi
    N=real-4j/np.pi*k*(1-k)
    return np.interp(left,-np.degrees(np.angle(N)),np.abs(N))
def margins(y,dt,kp,ti,ts,nw=120):
    m,nt=y.shape; out=np.zeros(m); gm=np.zeros(m); pm=np.zeros(m)
    t=(np.arange(nt-1)+.5)*dt; dy=np.diff(y,axis=1)
    for T in np.unique(ts):
        for part in np.array_split(np.flatnonzero(ts==T),max(1,(ts==T).sum()//500)):
            w=np.geomspace(3e-4,np.pi/T,nw); P=dy[part]@np.exp(-1j*np.outer(t,w))
            s=1j*w; law=kp[part,None]*(1+T/ti[part,None]/(1-np.exp(-s*T))); hold=(1-np.exp(-s*T))/(s*T)
            Lall=law*hold*P
            for j,L in zip(part,Lall):
                left=180+np.degrees(np.unwrap(np.angle(L))); ins=(left>0)&(left<90)
                out[j]=np.max(np.abs(L[ins])*Nsize(left[ins])) if ins.any() else 0
                neg=np.flatnonzero((left[:-1]>0)&(left[1:]<=0)); gm[j]=1/max(np.max(np.abs(L[i])) for i in neg) if neg.size else 99
                cr=np.flatnonzero((np.abs(L[:-1])>=1)&(np.abs(L[1:])<1)); pm[j]=min(left[cr]) if cr.size else 180
    return out,gm,pm
